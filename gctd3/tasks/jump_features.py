"""Node features of a robot that jumps: the commanded height, a clock of the jump and, for critics, its apex."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gctd3.errors import ConfigError
from gctd3.robots.gait_pattern import GaitPattern
from gctd3.robots.robot import Robot
from gctd3.tasks.features import (
    FootContact,
    Height,
    JointAngle,
    JointVelocity,
    NodeFeature,
    Reading,
    Sensed,
    Velocity,
)
from gctd3.tasks.jump_command import HEIGHT
from gctd3.tasks.jump_memory import APEX, ARRAYS, clearance
from gctd3.tasks.terminations import STEPS
from gctd3.tasks.terms import Remembered
from gctd3.tasks.velocity_features import GravityDirection, GravityUp, Gyroscope, LastAction

COMMANDED = "command_height_dm"
DECIMETRES = 10.0  # in a metre: levels of a few centimetres differ by about as much as angles do
SINE, COSINE = "jump_sin_1", "jump_cos_1"


@dataclass(frozen=True)
class CommandHeight(NodeFeature):
    """Sense the commanded height of the jump (dm) at the root."""

    kind: ClassVar[str] = "root"

    def readings(self, robot: Robot, nodes: tuple[str, ...]) -> list[list[Reading | None]]:
        """Return the reading of the command."""
        meaning = "commanded height of the soles above the ground at the apex of the jump"
        return [[Reading(COMMANDED, meaning, "command", source="command")]]

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return the command, shape ``[*, 1, 1]``."""
        return DECIMETRES * sensed.memory[HEIGHT][..., None, :]


@dataclass(frozen=True)
class JumpClock(NodeFeature):
    """Show, at the root, the time since the episode began, as sines and cosines of multiples of one frequency.

    A robot that goes on after an episode would jump again each period.

    Attributes:
        period: Time after which the slowest sine repeats: longer than an episode (s).
        multiples: Multiples of its frequency, of which the first is 1; fast ones tell neighbouring steps apart.
    """

    kind: ClassVar[str] = "root"

    period: float = 3.0
    multiples: Sequence[int] = (1, 2, 4, 8)

    def __post_init__(self) -> None:
        if not 0 < self.period <= 1000:
            raise ConfigError(f"period must be above 0 s and at most 1000 s, got {self.period}.")
        if not self.multiples or self.multiples[0] != 1 or len(set(self.multiples)) < len(self.multiples):
            raise ConfigError(f"multiples must begin with 1, and hold no number twice, got {list(self.multiples)}.")

    def pattern(self, robot: Robot) -> GaitPattern:
        """Return the jump as a gait of which all feet have the same phase, that of the time."""
        return GaitPattern(1.0 / self.period, np.zeros(len(robot.feet)))

    def readings(self, robot: Robot, nodes: tuple[str, ...]) -> list[list[Reading | None]]:
        """Return the readings: sine and cosine of each multiple."""
        return [
            [
                Reading(
                    f"jump_{wave}_{multiple}",
                    f"{meaning} of {multiple} times the phase of the jump",
                    "command",
                    source="clock",
                    frequency=multiple / self.period,
                    phase=ahead,
                )
                for multiple in self.multiples
                # A cosine is a sine a quarter of a period ahead.
                for wave, meaning, ahead in (("sin", "sine", 0.0), ("cos", "cosine", 0.25))
            ]
        ]

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return sines and cosines, shape ``[*, 1, 2 * multiples]``."""
        turns = 2 * math.pi * sensed.memory[STEPS] * sensed.facts.control_dt / self.period
        waves = [wave(multiple * turns) for multiple in self.multiples for wave in (np.sin, np.cos)]
        return np.stack(waves, axis=-1)[..., None, :]


@dataclass(frozen=True)
class JumpApex(NodeFeature):
    """Tell, at the root, the apex of the jump so far, and how high the lowest sole is in flight (dm)."""

    kind: ClassVar[str] = "root"

    def remembers(self) -> tuple[Remembered, ...]:
        """Return the arrays of the jump."""
        return ARRAYS

    def readings(self, robot: Robot, nodes: tuple[str, ...]) -> list[list[Reading | None]]:
        """Return the readings of both heights."""
        apex, above = "greatest height of the lowest sole in the episode", "height of the lowest sole in flight, else 0"
        return [
            [
                Reading("apex_dm", apex, "length", source="simulator"),
                Reading("clearance_dm", above, "length", source="simulator"),
            ]
        ]

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return both, shape ``[*, 1, 2]``."""
        heights = [np.asarray(sensed.memory[APEX.name]), np.asarray(clearance(sensed.now, sensed.facts))]
        return DECIMETRES * np.stack(heights, axis=-1)[..., None, :]


def jump_features() -> dict[str, NodeFeature]:
    """Return the features that the policy observes, for which robots have sensors, in their order in a node."""
    return {
        "gravity_up": GravityUp(),
        "gravity": GravityDirection(),
        "gyroscope": Gyroscope(),
        "command": CommandHeight(),
        "clock": JumpClock(),
        # Joints that stand bent in different ways share the network's weights.
        "angle": JointAngle(from_home=True),
        "angular_velocity": JointVelocity(),
        "last_action": LastAction(),
        "contact": FootContact(),
    }


def jump_privileged() -> dict[str, NodeFeature]:
    """Return the features that only critics observe: what robots have no sensor for."""
    return {"height": Height(), "velocity": Velocity(), "apex": JumpApex()}
