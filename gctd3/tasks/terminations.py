"""Terminations of the walking task; their defaults are the paper's numbers.

Source: Phan Bui et al. 2022, Table 3 and section 3.2, and the training script that the paper's authors released;
``paper_terminations`` of :mod:`gctd3.tasks.walk` names the source of each number.
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
STEPS = "step"  # name of the remembered control steps of the episode, shape [*]


@dataclass(frozen=True)
class Fall(Termination):
    """Terminate when the body drops or tilts, another part than a foot touches the ground, or the simulation fails.

    Attributes:
        height: Body height below which the robot has fallen (m from standing; released script); ``None`` for that of
            :attr:`drop`.
        drop: The same as a share of the leg's length, used where ``height`` is ``None``.
        tilt: Angle between the body's vertical and the world's above which the robot has fallen (rad); ``None`` for no
            bound. A boom holds the body upright.
        shanks: Whether a shank on the ground is a fall, too. A shank that carries a foot of its own may graze the
            ground beside it, as a crouching quadruped's does.
    """

    fatal: ClassVar[bool] = True

    height: float | None = -0.1
    drop: float = 0.4
    tilt: float | None = 0.8
    shanks: bool = True

    def __post_init__(self) -> None:
        if not self.drop > 0:
            raise ConfigError(f"drop must be above 0, got {self.drop}.")
        if self.tilt is not None and not self.tilt > 0:
            raise ConfigError(f"tilt must be above 0 rad, or null, got {self.tilt}.")

    def __call__(self, step: Step) -> Array:
        """Return whether the robot has fallen, shape ``[*]``."""
        now = step.now
        lowest = -self.drop * step.facts.leg_length if self.height is None else self.height
        fell = (now.height < lowest) | now.other_down | step.diverged
        fell = fell | now.shank_down if self.shanks else fell
        return fell if self.tilt is None else fell | (now.tilt > self.tilt)


@dataclass(frozen=True)
class LongContact(Termination):
    """Terminate when a foot has been on the ground for too long (Table 3).

    Attributes:
        steps: Longest contact of a foot (control steps; released script); ``None`` for no limit.
    """

    steps: int | None = 40

    def __post_init__(self) -> None:
        check_steps(self.steps)

    def remembers(self) -> tuple[Remembered, ...]:
        """Return the arrays of each foot's contact time and swing time."""
        return CONTACT_STEPS, AIR_STEPS

    def __call__(self, step: Step) -> Array:
        """Return whether a foot has been on the ground for too long, shape ``[*]``."""
        return longer_than(step, CONTACT_STEPS.name, self.steps)

    def clock(self, after: Mapping[str, Array], facts: RobotFacts, time_limit: int) -> Array:
        """Return each foot's contact time, or minus its swing time, divided by the limit, shape ``[*, feet]``."""
        return (after[CONTACT_STEPS.name] - after[AIR_STEPS.name]) / (self.steps or time_limit)

    def clock_mirror(self, facts: RobotFacts) -> tuple[np.ndarray, np.ndarray]:
        """Return source and sign of the clock's reflection, which exchanges the feet."""
        return facts.mirror_feet, np.ones(facts.feet)


@dataclass(frozen=True)
class StuckHip(Termination):
    """Terminate when a hip's angle has kept its sign for too long (released script).

    Attributes:
        steps: Longest time of a hip's angle with one sign (control steps); ``None`` for no limit.
    """

    steps: int | None = 50

    def __post_init__(self) -> None:
        check_steps(self.steps)

    def remembers(self) -> tuple[Remembered, ...]:
        """Return the arrays of the time for which each hip has kept its sign, and of the sign."""
        return HIP_STEPS, HIP_POSITIVE

    def __call__(self, step: Step) -> Array:
        """Return whether a hip has kept its sign for too long, shape ``[*]``."""
        return longer_than(step, HIP_STEPS.name, self.steps)

    def clock(self, after: Mapping[str, Array], facts: RobotFacts, time_limit: int) -> Array:
        """Return each hip's time on one side divided by the limit, with the side's sign, shape ``[*, feet]``."""
        hip = after[HIP_STEPS.name] / (self.steps or time_limit)
        # Computed by multiplication, which needs no array library's functions.
        return hip * (2 * after[HIP_POSITIVE.name] - 1)

    def clock_mirror(self, facts: RobotFacts) -> tuple[np.ndarray, np.ndarray]:
        """Return source and sign of the clock's reflection: legs exchange, and signs where the hip axes require it."""
        return facts.mirror_feet, facts.hip_mirror_signs


@dataclass(frozen=True)
class Finish(Termination):
    """Terminate successfully at a distance (section 3.2); the value is bootstrapped.

    Attributes:
        distance: Distance of the finish from the start (m).
    """

    truncates: ClassVar[bool] = True
    succeeds: ClassVar[bool] = True

    distance: float = 15.0

    def __post_init__(self) -> None:
        if not self.distance > 0:
            raise ConfigError(f"distance must be above 0 m, got {self.distance}.")

    def __call__(self, step: Step) -> Array:
        """Return whether the robot has reached the finish, shape ``[*]``."""
        return step.now.position >= self.distance


@dataclass(frozen=True)
class TimeLimit(Termination):
    """End the episode by truncation after a time limit; the value is bootstrapped.

    Attributes:
        steps: Time limit (control steps).
    """

    truncates: ClassVar[bool] = True

    steps: int = 1600

    def __post_init__(self) -> None:
        check_between(self, 1, MOST_STEPS, "steps")

    def __call__(self, step: Step) -> Array:
        """Return whether the time limit is reached, shape ``[*]``."""
        return step.after[STEPS] >= self.steps


@dataclass(frozen=True)
class Survive(TimeLimit):
    """End the episode successfully after a time limit that the robot has lasted for; the value is bootstrapped."""

    succeeds: ClassVar[bool] = True


def check_steps(steps: int | None) -> None:
    """Raise a :class:`.ConfigError` unless a limit is at least one control step, or ``None``."""
    if steps is not None and steps < 1:
        raise ConfigError(f"steps must be at least 1, or null, got {steps}.")


def longer_than(step: Step, name: str, limit: int | None) -> Array:
    """Return whether any of the times ``[*, K]`` remembered by a name exceeds a limit, shape ``[*]``."""
    times = step.after[name]
    if limit is None:
        return step.xp.zeros(times.shape[:-1], dtype=step.xp.bool)
    return step.xp.any(times > limit, axis=-1)
