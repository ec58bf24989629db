"""A clock of the gait: the policy observes it, and the reward asks that the feet keep to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gctd3.errors import ConfigError
from gctd3.robots.gait_pattern import GaitPattern, alternating_phases, stride_frequency
from gctd3.robots.nodes import foot_slots
from gctd3.robots.robot import Robot
from gctd3.tasks.features import NodeFeature, Reading, Sensed
from gctd3.tasks.measurement import Measurement
from gctd3.tasks.terms import Array, Remembered, RewardTerm, RobotFacts, Step
from gctd3.tasks.velocity_command import VELOCITY

PHASES = "foot_phases"  # name of the remembered phases of the feet, shape [*, feet] (periods)


@dataclass(frozen=True)
class _Begin:
    """Return the feet's phases at the start of an episode."""

    def __call__(self, now: Measurement, facts: RobotFacts) -> np.ndarray:
        return np.broadcast_to(facts.foot_phases, (*now.position.shape, facts.feet)).copy()


@dataclass(frozen=True)
class _Advance:
    """Return the feet's phases a control step later.

    Attributes:
        frequency: Strides per second (Hz); ``None`` for that of ``froude``.
        froude: Froude number.
    """

    frequency: float | None
    froude: float

    def strides(self, leg_length: float) -> float:
        return self.frequency if self.frequency is not None else stride_frequency(leg_length, self.froude)

    def __call__(self, before: Array, step: Step) -> Array:
        return (before + self.strides(step.facts.leg_length) * step.facts.control_dt) % 1.0


@dataclass(frozen=True)
class GaitClock(NodeFeature):
    """Show, at the ground, the phase of a stride as its sine and cosine, the same in every episode from its start on.

    Legs take turns: the left and the right one of a pair, and pairs that are neighbours
    (:func:`.alternating_phases`). A foot is to swing in the first half of its period; :class:`GaitSchedule` rewards it.
    Clocks of this kind are common in learned locomotion (Siekmann et al. 2021, arXiv:2011.01387).

    Attributes:
        frequency: Strides per second (Hz); ``None`` for that of animals at ``froude``.
        froude: Froude number ``v^2 / (g L)`` of the speed for which the frequency is, at legs of length ``L``.
    """

    kind: ClassVar[str] = "ground"

    frequency: float | None = None
    froude: float = 0.3

    def __post_init__(self) -> None:
        if self.frequency is not None and not 0 < self.frequency <= 10:
            raise ConfigError(f"frequency must be above 0 and at most 10 Hz, or null, got {self.frequency}.")
        if not self.froude > 0:
            raise ConfigError(f"froude must be above 0, got {self.froude}.")

    def pattern(self, robot: Robot) -> GaitPattern:
        """Return the frequency and the phases of the feet for a robot."""
        return GaitPattern(self._advance.strides(robot.leg_length), alternating_phases(robot))

    @property
    def _advance(self) -> _Advance:
        return _Advance(self.frequency, self.froude)

    def remembers(self) -> tuple[Remembered, ...]:
        """Return the array of the feet's phases."""
        return (Remembered(PHASES, ("feet",), _Begin(), self._advance),)

    def readings(self, robot: Robot, nodes: tuple[str, ...]) -> list[list[Reading | None]]:
        """Return the readings of each ground node: sine and cosine of its first foot's phase."""
        # In the mirror the feet of a pair have each other's phase, which is half a period away.
        sign = -1.0 if any(len(pair) > 1 for pair in robot.foot_pairs) else 1.0
        rows: list[list[Reading | None]] = [[] for _ in nodes]
        pattern = self.pattern(robot)
        for foot, phase, (node, place) in zip(robot.feet, pattern.phases, foot_slots(robot), strict=True):
            if place == 0:
                rows[node] = [
                    Reading(
                        f"{wave}_{foot}",
                        f"{meaning} of the phase of this foot's stride",
                        "command",
                        sign,
                        source="clock",
                        frequency=pattern.frequency,
                        phase=float(phase + ahead),
                    )
                    # A cosine is a sine a quarter of a period ahead.
                    for wave, meaning, ahead in (("clock_sin", "sine", 0.0), ("clock_cos", "cosine", 0.25))
                ]
        return rows

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return sine and cosine, shape ``[*, nodes, 2]``."""
        node, place = sensed.facts.foot_slots.T
        phases = sensed.memory[PHASES]
        numbers = np.zeros((*phases.shape[:-1], -int(node.min()), 2))
        first = np.flatnonzero(place == 0)
        turns = 2 * np.pi * phases[..., first]
        numbers[..., node[first], :] = np.stack([np.sin(turns), np.cos(turns)], axis=-1)
        return numbers


@dataclass(frozen=True)
class GaitSchedule(RewardTerm):
    """Penalise feet that are down when the clock lets them swing, or up when it lets them stand.

    ``weight`` times the share of such feet, after Siekmann et al. 2021 (arXiv:2011.01387); the task needs a
    :class:`GaitClock`. A robot that is commanded to stand (:class:`.VelocityCommand`) may keep all feet down.

    Attributes:
        margin: Share of a period before and after each change in which a foot may be up or down.
    """

    weight: float = -1.0
    margin: float = 0.08

    def __post_init__(self) -> None:
        if not 0 <= self.margin < 0.25:
            raise ConfigError(f"margin must be at least 0 and below 0.25, got {self.margin}.")

    def __call__(self, step: Step) -> Array:
        """Return ``weight`` times the share of feet that are not where the clock has them, shape ``[*]``."""
        xp, down = step.xp, step.now.feet_down
        phases = step.after[PHASES]
        swing = (phases > self.margin) & (phases < 0.5 - self.margin)
        stance = (phases > 0.5 + self.margin) & (phases < 1.0 - self.margin)
        moves = xp.any(step.before[VELOCITY] != 0.0, axis=-1)[..., None] if VELOCITY in step.before else True
        off = (swing & down & moves) | (stance & ~down)
        return self.weight * xp.mean(xp.astype(off, step.now.velocity.dtype), axis=-1)
