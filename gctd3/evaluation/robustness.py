"""Robustness of a walking policy: pushes at every phase of the stride, other masses and floors, late actions, noise."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from gctd3.envs.factory import build_env
from gctd3.envs.settings import EnvSettings
from gctd3.envs.simulation import Simulation
from gctd3.evaluation.gait_metrics import SHORTEST_SWING
from gctd3.evaluation.perturbations import (
    Delayed,
    Noisy,
    PolicyFunction,
    Pushed,
    Shoved,
    altered,
    resting_action,
    sensor_deviation,
)
from gctd3.evaluation.recorder import total_mass
from gctd3.evaluation.rollout import evaluate
from gctd3.evaluation.settings import Perturbations
from gctd3.evaluation.tracking import WITHIN
from gctd3.progress import tracked
from gctd3.tasks.simulated_task import SimulatedTask
from gctd3.tasks.terms import period

DIRECTIONS = {"forward": 1.0, "backward": -1.0}
AS_TRAINED = "as trained"
# Makes the policy that acts in a simulation, and the task that is simulated.
Condition = tuple[Callable[[Simulation], PolicyFunction], SimulatedTask]


@dataclass(frozen=True)
class Examination:
    """Evaluate the robustness of a policy under perturbations.

    Attributes:
        policy: The policy.
        task: The task on which the policy is evaluated.
        env: Settings of the environment; its number of robots is the number of episodes of each condition.
        seed: Seed of the starts and of the noise.
        perturbations: Settings of the perturbations.
    """

    policy: PolicyFunction
    task: SimulatedTask
    env: EnvSettings
    seed: int
    perturbations: Perturbations

    def results(self, stride_time: float | None) -> dict[str, Any]:
        """Evaluate the policy under all conditions and return the results, ready for JSON.

        Args:
            stride_time: Stride time of the policy's gait (s); ``None`` for a gait without strides, which has no phases
                at which to push.
        """
        conditions: dict[str, dict[str, float | int]] = {}
        tried = self._conditions()
        for name, (policy, task) in tracked(tried.items(), "trying conditions", len(tried)):
            env = build_env(task, self.env, self.seed)
            acting = policy(env.base_env.simulation)
            conditions[name] = evaluate(acting, env, task, self.seed).summary()
        return {
            "perturbations": asdict(self.perturbations),
            "mass_kg": total_mass(self.task.robot),
            "seed": self.seed,
            "conditions": conditions,
            "pushes": None if stride_time is None else self.pushes(stride_time),
        }

    def _conditions(self) -> dict[str, Condition]:
        """Return, by the name of each condition, a function that makes the policy for a simulation, and the task."""
        p, task, robot = self.perturbations, self.task, self.task.robot
        noise = sensor_deviation(task, p.angle_noise, p.velocity_noise, p.height_noise, p.speed_noise)
        plain = self._as_it_is
        made: dict[str, Condition] = {AS_TRAINED: (plain, task)}
        for factor in p.masses:
            made[f"mass {_percent(factor)}"] = plain, task.on(altered(robot, mass=factor))
        for factor in p.frictions:
            made[f"friction {_percent(factor)}"] = plain, task.on(altered(robot, friction=factor))
        for steps in p.delays:
            late = partial(self._late, steps)
            made[f"actions {steps} step{'s' * (steps != 1)} late"] = late, task
        made["sensor noise"] = lambda _: Noisy(self.policy, noise, self.seed), task
        if "commands" in task.abilities and p.shove:
            made[f"pushes of {p.shove:g} m/s, {p.shove_every:g} s apart"] = self._shoved, task
        return made

    def _as_it_is(self, simulation: Simulation) -> PolicyFunction:
        return self.policy

    def _late(self, steps: int, simulation: Simulation) -> PolicyFunction:
        return Delayed(self.policy, steps, resting_action(simulation.task.robot))

    def _shoved(self, simulation: Simulation) -> PolicyFunction:
        p = self.perturbations
        return Shoved(self.policy, simulation, p.shove, period(p.shove_every, self.task.control_dt), self.seed)

    def pushes(self, stride_time: float) -> dict[str, Any]:
        """Push robots with every impulse at every phase in both directions, all in one batch.

        ``survived`` is the share of starts, by direction, phase and impulse, ``None`` where no robot got that far;
        ``largest`` is the impulse (N s) up to which all survive, by direction and phase.
        """
        p, dt = self.perturbations, self.task.control_dt
        period = stride_time / dt
        shape = (len(DIRECTIONS), p.phases, len(p.impulses), p.starts)
        direction, phase, impulse, _ = (axis.ravel() for axis in np.indices(shape))
        signs = np.array(list(DIRECTIONS.values()))
        env = build_env(self.task, self.env.for_evaluation(direction.size, self.env.threads), self.seed)
        pushed = Pushed(
            self.policy,
            env.base_env.simulation,
            signs[direction] * np.array(p.impulses)[impulse],
            np.round(phase / p.phases * period).astype(np.int64),
            p.settle,
            max(1, round(SHORTEST_SWING * period)),
        )
        episodes = evaluate(pushed, env, self.task, self.seed).episodes
        lasted = np.array([len(episode.reward) for episode in episodes]) - pushed.pushed_at
        stood = (lasted >= p.recover / dt) | np.array([episode.success for episode in episodes])
        # A robot that fell before is simulated further, but its episode is over.
        known = (pushed.pushed_at >= 0) & (lasted > 0)
        stood, known = (stood & known).reshape(shape), known.reshape(shape)
        rates = np.where(known.any(axis=-1), stood.sum(axis=-1) / np.maximum(known.sum(axis=-1), 1), np.nan)
        return {
            "stride_time_s": stride_time,
            "never_pushed": int((~known).sum()),
            "survived": dict(zip(DIRECTIONS, _plain(rates), strict=True)),
            "largest": dict(zip(DIRECTIONS, _plain(largest(rates, p.impulses)), strict=True)),
        }


def largest(rates: np.ndarray, impulses: Sequence[float]) -> np.ndarray:
    """Find the largest impulse such that all survive it and every smaller one; 0 if not all survive the smallest.

    Args:
        rates: Shares that survive, shape ``[*, impulses]``; NaN where no robot was pushed.
        impulses: Impulses in rising order (N s).

    Returns:
        Largest impulse survived, shape ``[*]`` (N s); NaN where no robot was pushed with the smallest.
    """
    steps = np.cumprod(rates >= 1.0, axis=-1).sum(axis=-1)
    survived = np.concatenate([[0.0], np.asarray(impulses, dtype=np.float64)])[steps]
    return np.where(np.isnan(rates[..., 0]), np.nan, survived)


def weakest(results: Mapping[str, Any], direction: str) -> float:
    """Return the largest impulse (N s) that is survived at every phase; NaN if no robot was pushed at one of them."""
    impulses = ((results.get("pushes") or {}).get("largest") or {}).get(direction, ())
    return math.nan if not impulses or None in impulses else float(min(impulses))


def table(results: Mapping[str, Any]) -> str:
    """Format the results as text: a line for each condition, then the pushes by phase."""
    conditions = results["conditions"]
    commanded = any("tracked_rate" in means for means in conditions.values())
    lines = _commanded(conditions) if commanded else _walking(conditions)
    pushes, p = results["pushes"], results["perturbations"]
    if pushes is None:
        return "\n".join([*lines, "", "The gait has no strides, so there are no phases at which to push."])
    lines += ["", f"Largest impulse survived by all {p['starts']} starts, N s, {p['settle']:g} m after the start"]
    phases = [f"{phase / p['phases']:.0%}" for phase in range(p["phases"])]
    lines.append(f"{'at this part of a stride':24}" + "".join(f"{phase:>7}" for phase in phases))
    for direction, values in pushes["largest"].items():
        lines.append(f"{direction:24}" + "".join(f"{_impulse(value, p['impulses']):>7}" for value in values))
    for direction in DIRECTIONS:
        least = weakest(results, direction)
        if math.isfinite(least):
            weakest_text = f"{_impulse(least, p['impulses'])} N s, {least / results['mass_kg']:.2f} m/s of its mass"
            lines.append(f"{direction}, at the worst moment: {weakest_text}")
    if pushes["never_pushed"]:
        lines.append(f"{pushes['never_pushed']} robots fell before they could be pushed and do not count.")
    return "\n".join(lines)


def _walking(conditions: Mapping[str, Mapping[str, float]]) -> list[str]:
    lines = [f"{'':24}{'success':>9}{'return':>16}{'m/s':>8}{'m':>8}"]
    for name, means in conditions.items():
        spread = f"{means['return_mean']:.1f} ± {means['return_std']:.1f}"
        numbers = f"{means['velocity_mean']:>8.3f}{means['distance_mean']:>8.2f}"
        lines.append(f"{name:24}{means['success_rate']:>9.2f}{spread:>16}{numbers}")
    return lines


def _commanded(conditions: Mapping[str, Mapping[str, float]]) -> list[str]:
    head = f"{'no fall':>9}{'tracked':>9}{'followed':>10}"
    lines = [f"{'':30}{head}{'forward':>10}{'side':>8}{'turn, rad/s':>13}"]
    for name, means in conditions.items():
        shares = f"{1 - means['fall_rate']:>9.0%}{means['tracked_rate']:>9.0%}{means['followed_rate']:>10.0%}"
        errors = f"{means['error_forward']:>10.2f}{means['error_side']:>8.2f}{means['error_turn']:>13.2f}"
        lines.append(f"{name:30}{shares}{errors}")
    within = f"Tracked: no fall, and a mean absolute error of at most {WITHIN:g} m/s in the plane."
    return [*lines, f"{within} Errors forward and to the side are in m/s."]


def _impulse(value: float | None, impulses: Sequence[float]) -> str:
    if value is None:
        return "-"
    # The largest impulse that was tried is a lower bound.
    return f"{'≥ ' if value >= impulses[-1] else ''}{value:g}"


def _percent(factor: float) -> str:
    return f"{(factor - 1.0) * 100:+.0f} %"


def _plain(values: np.ndarray) -> Any:  # noqa: ANN401 - nested lists
    """Convert an array to nested lists, with ``None`` for numbers that are not finite."""
    if values.ndim:
        return [_plain(row) for row in values]
    return float(values) if np.isfinite(values) else None
