"""The first step of a task, in which each of its terms is run once and checked."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from gctd3.errors import ConfigError
from gctd3.tasks.features import Sensed
from gctd3.tasks.fitting import named
from gctd3.tasks.term_checks import called, reading
from gctd3.tasks.terms import Step

if TYPE_CHECKING:
    from gctd3.tasks.simulated_task import SimulatedTask


def try_terms(task: SimulatedTask) -> int:
    """Run every term of a task once, on the standing robot, so that one that does not fit is reported early.

    Returns:
        How many numbers only critics observe.

    Raises:
        ConfigError: If a term does not return what is asked of it, or reads what is not remembered.
        TermError: If a term raises an error of its own.
    """
    robot, batch = task.robot, (2,)
    model = robot.model
    zeros = np.zeros((*batch, model.nv)), np.zeros((*batch, model.nsensordata))
    now = task.measure(np.broadcast_to(robot.standing_qpos, (*batch, model.nq)), *zeros)
    rng = np.random.default_rng(0)
    for name, randomise in task.randomisations.items():
        start = robot.start_qpos.copy(), np.zeros(model.nv)
        drawn = called(f"task.randomisations.{name}", randomise, rng, robot, *start)
        shapes = [np.shape(values) for values in drawn] if isinstance(drawn, tuple) else type(drawn).__name__
        if shapes != [(model.nq,), (model.nv,)] or not all(np.isfinite(values).all() for values in drawn):
            raise ConfigError(
                f"task.randomisations.{name} must return finite qpos [{model.nq}] and qvel [{model.nv}], got {shapes}."
            )
    first = task.begin(now, rng)
    for table in (task.table, *([] if task.privileged is None else [task.privileged])):
        table.check(Sensed(now, first, task.facts))
    nothing = np.zeros((*batch, task.facts.actions)), np.zeros(batch, dtype=bool)
    step = Step(now, first, {}, *nothing, task.facts, {})
    with np.errstate(all="ignore"):
        task.memory.check(first, step)
        step = replace(step, after=task.memory.advance(step, rng))
        ended = named("task.terminations", task.terminations)
        held = {where: reading(where, term, step.before, step) for where, term in ended.items()}
        step = replace(step, ended=dict(zip(task.terminations, held.values(), strict=True)))
        rewarded = named("reward.terms", task.terms)
        paid = {where: reading(where, term, step.before, step) for where, term in rewarded.items()}
    for values, kinds, asked in ((held, "b", "true or false"), (paid, "fiu", "a finite number")):
        for where, value in values.items():
            given = np.asarray(value)
            if given.shape != batch or given.dtype.kind not in kinds or not np.isfinite(given).all():
                raise ConfigError(
                    f"{where} must return {asked} for each robot, shape {list(batch)}, got {list(given.shape)} "
                    f"{given.dtype}{'' if np.isfinite(given).all() else ' that is not finite'}."
                )
    for where, term in ended.items():
        clock = called(where, term.clock, first, task.facts, task.time_limit)
        source, sign = called(where, term.clock_mirror, task.facts)
        length = 0 if clock is None else np.shape(clock)[-1]
        if len(source) != length or len(sign) != length:
            raise ConfigError(
                f"{where}: clock_mirror must return a source and a sign for each of the {length} numbers of clock, "
                f"got {len(source)} and {len(sign)}."
            )
    return int(task.counters(first, now).shape[-1])
