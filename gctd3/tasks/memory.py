"""The memory of an episode: the arrays that the task's terms declare, a step counter, and commands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from gctd3.errors import ConfigError
from gctd3.tasks.domain_randomisation import Domain
from gctd3.tasks.ground import FARTHEST, LANE, LEVELS
from gctd3.tasks.heading import coordinate
from gctd3.tasks.measurement import Measurement
from gctd3.tasks.sensor_noise import OWN_NOISE, SensorNoise
from gctd3.tasks.slew import approached
from gctd3.tasks.term_checks import called, reading
from gctd3.tasks.terminations import STEPS
from gctd3.tasks.terms import Command, Remembered, RobotFacts, Step, period

Memory = dict[str, np.ndarray]  # by name; every array is overwritten by the next, none changes in place
Generator = np.random.Generator | np.random.RandomState
COMMAND = "command."  # prefix of a command's name in the memory


class Remembering(Protocol):
    """Represent a part of a task that remembers arrays from step to step."""

    def remembers(self) -> tuple[Remembered, ...]:
        """Return the arrays."""


class EpisodeMemory:
    """Begin and advance the memory of an episode.

    Args:
        terms: Terms and features whose arrays are remembered, by a name for messages.
        commands: Commands by name.
        facts: Facts of the robot.
        domain: Differences between robots, if there are any.
        noise: Errors of the features' own, if there are any.

    Raises:
        ConfigError: If two terms remember different arrays by one name.
    """

    def __init__(
        self,
        terms: Mapping[str, Remembering],
        commands: Mapping[str, Command],
        facts: RobotFacts,
        domain: Domain | None = None,
        noise: SensorNoise | None = None,
    ) -> None:
        self.commands, self.facts, self.domain, self.noise = commands, facts, domain, noise
        self.ground = facts.ground
        requests: dict[str, tuple[str, Remembered]] = {}
        for where, term in {**terms, **{f"task.commands.{name}": one for name, one in commands.items()}}.items():
            for one in called(where, term.remembers):
                asked, known = requests.setdefault(one.name, (where, one))
                if known != one or one.name == STEPS or one.name.startswith(COMMAND):
                    raise ConfigError(f"{where} and {asked} remember different things by the name {one.name!r}.")
        self.remembered = {name: one for name, (_, one) in requests.items()}
        self.asked = {name: where for name, (where, _) in requests.items()}
        self.lasting = [name for name, one in self.remembered.items() if one.lasting]
        if self.ground is not None:
            self.lasting += [LANE, FARTHEST, LEVELS]

    def begin(
        self,
        now: Measurement,
        rng: Generator | None = None,
        last: Mapping[str, np.ndarray] | None = None,
        spot: Mapping[str, np.ndarray] | None = None,
    ) -> Memory:
        """Return the memory at the start of an episode; see :meth:`.SimulatedTask.begin`."""
        memory = {STEPS: np.zeros(now.position.shape, dtype=np.int64)}
        if self.ground is not None:
            memory |= spot or self.ground.first(now.position.shape)
        for name, one in self.remembered.items():
            if last is not None and one.lasting:
                memory[name] = last[name]
            else:
                memory[name] = np.asarray(called(self.asked[name], one.begin, now, self.facts))
        for name, command in self.commands.items():
            memory |= self._drawn(name, command, now.position.shape, rng, memory)
        if self.domain is not None:
            memory |= self.domain.begin(now.position.shape, _generator(rng))
        if self.noise is not None:
            memory[OWN_NOISE] = self.noise.draw(now.position.shape, _generator(rng))
        return memory

    def advance(self, step: Step, rng: Generator | None = None) -> Memory:
        """Return the memory after a step, where ``step.before`` is the memory before it."""
        before = step.before
        after = {STEPS: before[STEPS] + 1}
        after |= {n: called(self.asked[n], one.update, before[n], step) for n, one in self.remembered.items()}
        for name, command in self.commands.items():
            after |= self._next(name, command, before, rng, after)
        if self.domain is not None:
            after |= self.domain.advance(before, step.action, _generator(rng))
        if self.ground is not None:
            after |= self.ground.advance(before, step.now, coordinate(step.now, self.facts, "side"))
        if self.noise is not None:
            after[OWN_NOISE] = self.noise.draw(step.now.position.shape, _generator(rng))
        return after

    def check(self, first: Memory, step: Step) -> None:
        """Raise a :class:`.ConfigError` unless the arrays have the declared shapes and keep their types.

        Args:
            first: Memory that :meth:`begin` returned.
            step: Step that follows it.
        """
        for name, one in self.remembered.items():
            expected = (*step.now.position.shape, *map(self.facts.size, one.shape))
            after = reading(self.asked[name], one.update, step.before, first[name], step)
            for when, values in (("at a reset", first[name]), ("after a step", np.asarray(after))):
                if values.shape != expected or values.dtype != first[name].dtype:
                    raise ConfigError(
                        f"{self.asked[name]} must remember {name!r} as {list(expected)} {first[name].dtype}, got "
                        f"{list(values.shape)} {values.dtype} {when}."
                    )

    def _drawn(
        self, name: str, command: Command, shape: tuple[int, ...], rng: Generator | None, memory: Memory
    ) -> Memory:
        if rng is None:
            raise ValueError(f"The command {name!r} is drawn at random: begin and advance need a generator.")
        count = int(np.prod(shape, dtype=int))
        drawn = np.asarray(called(f"task.commands.{name}", command.draw, rng, count, memory))
        if drawn.shape != (count, command.size):
            raise ConfigError(
                f"task.commands.{name} must draw {[count, command.size]} numbers, got {list(drawn.shape)}."
            )
        drawn = drawn.reshape(*shape, command.size)
        key, left = f"{COMMAND}{name}", period(command.every, self.facts.control_dt)
        timer = {f"{key}.left": np.full(shape, left, dtype=np.int64)}
        if command.slew_rates is None:
            return {key: drawn, **timer}
        return {key: np.broadcast_to(command.still, drawn.shape).copy(), target_of(key): drawn, **timer}

    def _next(
        self,
        name: str,
        command: Command,
        before: Mapping[str, np.ndarray],
        rng: Generator | None,
        after: Memory,
    ) -> Memory:
        key, timer = f"{COMMAND}{name}", f"{COMMAND}{name}.left"
        left, rates = before[timer] - 1, command.slew_rates
        drawn = key if rates is None else target_of(key)
        now, over = before[drawn], np.asarray(left <= 0)
        if over.any():
            # Rows for all robots are drawn, so that the number of due robots does not change the others' commands.
            fresh = self._drawn(name, command, over.shape, rng, after)
            now, left = np.where(over[..., None], fresh[drawn], now), np.where(over, fresh[timer], left)
        if rates is None:
            return {key: now, timer: left}
        return {key: approached(before[key], now, rates * self.facts.control_dt), drawn: now, timer: left}


def target_of(command: str) -> str:
    """Return the name of the array that a command of the memory approaches, which has slew rates."""
    return f"{command}.target"


def _generator(rng: Generator | None) -> Generator:
    if rng is None:
        raise ValueError("Differences between robots are drawn at random: begin and advance need a generator.")
    return rng
