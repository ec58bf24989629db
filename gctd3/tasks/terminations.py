"""Terminations of the walking task; their defaults are the paper's numbers.

Source: Phan Bui et al. 2022, Table 3 and section 3.2, and the training script that the paper's authors released; which
number has which source stands in ``conf/task/walk.yaml``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gctd3.errors import ConfigError, check_between
from gctd3.tasks.gait_memory import AIR_STEPS, CONTACT_STEPS, HIP_POSITIVE, HIP_STEPS
from gctd3.tasks.terms import Array, Remembered, RobotFacts, Step, Termination

MOST_STEPS = 10**9  # control steps
STEPS = "step"  # what every task remembers: control steps of the episode, shape [*]


@dataclass(frozen=True)
class Fall(Termination):
    """End when the body has dropped or tilted, when anything but a foot is on the ground, or the simulation failed.

    Attributes:
        height: Body height below which the robot has fallen (m from standing; released script).
        tilt: Angle between the body's vertical and the world's above which it has fallen (rad); ``None`` for any. A
            boom holds the body upright.
    """

    fatal: ClassVar[bool] = True

    height: float = -0.1
    tilt: float | None = 0.8

    def __post_init__(self) -> None:
        if self.tilt is not None and not self.tilt > 0:
            raise ConfigError(f"tilt must be above 0 rad, or null, got {self.tilt}.")

    def __call__(self, step: Step) -> Array:
        """Return whether it has fallen, shape ``[*]``."""
        now = step.now
        fell = (now.height < self.height) | now.other_down | step.diverged
        return fell if self.tilt is None else fell | (now.tilt > self.tilt)


@dataclass(frozen=True)
class LongContact(Termination):
    """End when a foot has been down for too long (Table 3).

    Attributes:
        steps: Control steps that a foot may stay down (released script); ``None`` for any number.
    """

    steps: int | None = 40

    def __post_init__(self) -> None:
        check_steps(self.steps)

    def remembers(self) -> tuple[Remembered, ...]:
        """Return for how long each foot has been down, and up."""
        return CONTACT_STEPS, AIR_STEPS

    def __call__(self, step: Step) -> Array:
        """Return whether some foot has, shape ``[*]``."""
        return longer_than(step, CONTACT_STEPS.name, self.steps)

    def clock(self, after: Mapping[str, Array], facts: RobotFacts, time_limit: int) -> Array:
        """Return each foot's contact time over its limit, or minus its time in the air, shape ``[*, feet]``."""
        return (after[CONTACT_STEPS.name] - after[AIR_STEPS.name]) / (self.steps or time_limit)

    def clock_mirror(self, facts: RobotFacts) -> tuple[np.ndarray, np.ndarray]:
        """Exchange the feet."""
        return facts.mirror_feet, np.ones(facts.feet)


@dataclass(frozen=True)
class StuckHip(Termination):
    """End when a hip's angle has kept its sign for too long (released script).

    Attributes:
        steps: Control steps that it may; ``None`` for any number.
    """

    steps: int | None = 50

    def __post_init__(self) -> None:
        check_steps(self.steps)

    def remembers(self) -> tuple[Remembered, ...]:
        """Return for how long each hip has kept its sign, and which one it is."""
        return HIP_STEPS, HIP_POSITIVE

    def __call__(self, step: Step) -> Array:
        """Return whether some hip has, shape ``[*]``."""
        return longer_than(step, HIP_STEPS.name, self.steps)

    def clock(self, after: Mapping[str, Array], facts: RobotFacts, time_limit: int) -> Array:
        """Return each hip's time on one side over its limit, with the side's sign, shape ``[*, feet]``."""
        hip = after[HIP_STEPS.name] / (self.steps or time_limit)
        # By multiplication: a function of an array library would have to be asked for.
        return hip * (2 * after[HIP_POSITIVE.name] - 1)

    def clock_mirror(self, facts: RobotFacts) -> tuple[np.ndarray, np.ndarray]:
        """Exchange the legs, and the sides where the hips' axes ask for it."""
        return facts.mirror_feet, facts.hip_mirror_signs


@dataclass(frozen=True)
class Finish(Termination):
    """End successfully at a distance (section 3.2); the value is bootstrapped.

    Attributes:
        distance: From the start (m).
    """

    truncates: ClassVar[bool] = True
    succeeds: ClassVar[bool] = True

    distance: float = 15.0

    def __post_init__(self) -> None:
        if not self.distance > 0:
            raise ConfigError(f"distance must be above 0 m, got {self.distance}.")

    def __call__(self, step: Step) -> Array:
        """Return whether it is there, shape ``[*]``."""
        return step.now.position >= self.distance


@dataclass(frozen=True)
class TimeLimit(Termination):
    """Cut the episode off after a time; the value is bootstrapped.

    Attributes:
        steps: Control steps.
    """

    truncates: ClassVar[bool] = True

    steps: int = 1600

    def __post_init__(self) -> None:
        check_between(self, 1, MOST_STEPS, "steps")

    def __call__(self, step: Step) -> Array:
        """Return whether the time is over, shape ``[*]``."""
        return step.after[STEPS] >= self.steps


def check_steps(steps: int | None) -> None:
    """Raise a :class:`.ConfigError` unless a limit is at least one control step, or ``None``."""
    if steps is not None and steps < 1:
        raise ConfigError(f"steps must be at least 1, or null, got {steps}.")


def longer_than(step: Step, name: str, limit: int | None) -> Array:
    """Return whether any of the times remembered by a name, shape ``[*, K]``, exceeds a limit, shape ``[*]``."""
    times = step.after[name]
    if limit is None:
        return step.xp.zeros(times.shape[:-1], dtype=step.xp.bool)
    return step.xp.any(times > limit, axis=-1)
