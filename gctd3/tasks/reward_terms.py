"""Terms of the walking reward; their defaults are the paper's numbers.

Source: Phan Bui et al. 2022, Table 3, and the training script that the paper's authors released; which number has which
source stands in ``conf/reward/paper.yaml``.
"""

from __future__ import annotations

from dataclasses import dataclass

from gctd3.errors import ConfigError, check_between
from gctd3.tasks.gait_memory import AIR_STEPS
from gctd3.tasks.terms import Array, Remembered, RewardTerm, RobotFacts, Step, recent


@dataclass(frozen=True)
class ForwardVelocity(RewardTerm):
    """Pay for forward velocity up to a target: ``weight * min(v, target)`` (Table 3).

    Attributes:
        target: Velocity beyond which the bonus no longer grows (m/s).
    """

    target: float = 0.9

    def __call__(self, step: Step) -> Array:
        """Return ``weight * min(v, target)``, shape ``[*]``."""
        velocity = step.now.velocity
        return self.weight * step.xp.minimum(velocity, step.xp.asarray(self.target, dtype=velocity.dtype))


@dataclass(frozen=True)
class Progress(RewardTerm):
    """Pay for the way made over the last steps: ``weight * (y_t - y_(t-h))`` (Table 3).

    Attributes:
        weight: Bonus per metre (1/m).
        steps: ``h`` (control steps).
    """

    weight: float = 0.2
    steps: int = 5

    def __post_init__(self) -> None:
        check_between(self, 1, 1000, "steps")

    def remembers(self) -> tuple[Remembered, ...]:
        """Return the last ``h + 1`` positions."""
        return (recent("position", self.steps + 1),)

    def __call__(self, step: Step) -> Array:
        """Return ``weight`` times the way made, shape ``[*]``."""
        positions = step.after[f"position[{self.steps + 1}]"]
        return self.weight * (positions[..., -1] - positions[..., 0])


@dataclass(frozen=True)
class BodyHeight(RewardTerm):
    """Penalise the distance of the body from its target height, summed over stacked frames (Table 3).

    A frame in which no foot is down costs nothing here.

    Attributes:
        weight: ``-c1``, per metre and frame (1/m).
        single: Target height with one foot down (m from standing).
        double: Target height with more feet down (m from standing).
        frames: Stacked frames.
    """

    weight: float = -0.005
    single: float = -0.010
    double: float = -0.025
    frames: int = 5

    def __post_init__(self) -> None:
        check_between(self, 1, 1000, "frames")

    def remembers(self) -> tuple[Remembered, ...]:
        """Return the stacked frames' heights and contacts."""
        return recent("height", self.frames), recent("feet_down", self.frames, "feet")

    def __call__(self, step: Step) -> Array:
        """Return ``weight`` times the sum of distances, shape ``[*]``."""
        xp, heights = step.xp, step.after[f"height[{self.frames}]"]
        feet = xp.sum(step.after[f"feet_down[{self.frames}]"], axis=-1)
        target = xp.where(feet == 1, self.single, self.double)
        return self.weight * xp.sum(xp.where(feet > 0, xp.abs(heights - target), 0.0), axis=-1)


@dataclass(frozen=True)
class Flight(RewardTerm):
    """Penalise stacked frames in which no foot is down (released script).

    Attributes:
        weight: Per frame.
        free: Frames that cost nothing.
        frames: Stacked frames.
    """

    weight: float = -0.01
    free: int = 0
    frames: int = 5

    def __post_init__(self) -> None:
        check_between(self, 1, 1000, "frames")
        check_between(self, 0, 1000, "free")

    def remembers(self) -> tuple[Remembered, ...]:
        """Return the stacked frames' contacts."""
        return (recent("feet_down", self.frames, "feet"),)

    def __call__(self, step: Step) -> Array:
        """Return ``weight`` times the number of frames, shape ``[*]``."""
        xp = step.xp
        feet = xp.sum(step.after[f"feet_down[{self.frames}]"], axis=-1)
        up = xp.sum(feet == 0, axis=-1) - self.free
        return self.weight * xp.where(up > 0, up, 0)


@dataclass(frozen=True)
class Living(RewardTerm):
    """Pay, or with a negative weight charge, for each step (released script)."""

    weight: float = -0.1

    def __call__(self, step: Step) -> Array:
        """Return ``weight``, shape ``[*]``."""
        velocity = step.now.velocity
        return step.xp.full(velocity.shape, self.weight, dtype=velocity.dtype)


@dataclass(frozen=True)
class Ended(RewardTerm):
    """Penalise the end of an episode by one of the task's terminations (Table 3).

    Attributes:
        by: Name of the termination.
    """

    weight: float = -10.0
    by: str = "fall"

    def reads(self) -> tuple[str, ...]:
        """Return the termination."""
        return (self.by,)

    def __call__(self, step: Step) -> Array:
        """Return ``weight`` where the termination holds, else 0, shape ``[*]``."""
        return self.weight * step.xp.astype(step.ended[self.by], step.now.velocity.dtype)


@dataclass(frozen=True)
class Antiphase(RewardTerm):
    """Penalise the sum of the hip angles of a left and a right leg, which is zero when they are opposite.

    Attributes:
        weight: Per radian (1/rad).
    """

    weight: float = -0.3

    def __call__(self, step: Step) -> Array:
        """Return ``weight`` times the sum over the pairs of legs, shape ``[*]``."""
        xp, facts, hips = step.xp, step.facts, step.hips
        hips = hips * step.constant(facts.hip_signs, hips)
        first, second = (xp.take(hips, xp.asarray(feet), axis=-1) for feet in facts.foot_pairs.T)
        return self.weight * xp.sum(xp.abs(first + second), axis=-1)


@dataclass(frozen=True)
class SingleSupport(RewardTerm):
    """Pay for each step with exactly one foot down."""

    weight: float = 0.1

    def __call__(self, step: Step) -> Array:
        """Return ``weight`` where one foot is down, else 0, shape ``[*]``."""
        xp = step.xp
        return self.weight * xp.astype(xp.sum(step.now.feet_down, axis=-1) == 1, step.now.velocity.dtype)


@dataclass(frozen=True)
class Overspeed(RewardTerm):
    """Penalise forward velocity above a bound.

    Attributes:
        weight: Per m/s above it (s/m).
        above: The bound (m/s).
    """

    weight: float = -1.0
    above: float = 1.2

    def __call__(self, step: Step) -> Array:
        """Return ``weight`` times the excess, shape ``[*]``."""
        excess = step.now.velocity - self.above
        return self.weight * step.xp.where(excess > 0.0, excess, 0.0)


@dataclass(frozen=True)
class SwingTime(RewardTerm):
    """Penalise, at a foot's touchdown, a time in the air that is too short or too long.

    After ``feet_air_time`` of Rudin et al. 2022 (arXiv:2109.11978), which pays for longer times.

    Attributes:
        weight: Per second too short or too long (1/s).
        least: Shortest time that costs nothing (s).
        most: Longest time that costs nothing (s).
    """

    weight: float = -12.0
    least: float = 0.34
    most: float = 0.36

    def __post_init__(self) -> None:
        if not 0 <= self.least <= self.most:
            raise ConfigError(f"least must be at least 0 s and at most most, got {self.least} and {self.most}.")

    def remembers(self) -> tuple[Remembered, ...]:
        """Return for how long each foot has been up."""
        return (AIR_STEPS,)

    def __call__(self, step: Step) -> Array:
        """Return ``weight`` times what is missing or too much, summed over the feet that touch down, shape ``[*]``."""
        xp, before = step.xp, step.before[AIR_STEPS.name]
        in_air = before * step.facts.control_dt
        short, long = self.least - in_air, in_air - self.most
        off = xp.where(short > 0.0, short, 0.0) + xp.where(long > 0.0, long, 0.0)
        touchdown = step.now.feet_down & (before > 0)
        # The weight stands inside of the sum: sums of products are not products of sums, in the last bit.
        return xp.sum(xp.where(touchdown, self.weight * off, 0.0), axis=-1)


@dataclass(frozen=True)
class Tilt(RewardTerm):
    """Penalise the angle between the body's vertical and the world's; a boom holds it at zero.

    Attributes:
        weight: Per radian (1/rad).
    """

    weight: float = -0.5

    def __call__(self, step: Step) -> Array:
        """Return ``weight`` times the angle, shape ``[*]``."""
        return self.weight * step.now.tilt


@dataclass(frozen=True)
class Heading(RewardTerm):
    """Penalise turning away from the forward axis, for a base that can turn.

    Attributes:
        weight: Per radian (1/rad).
    """

    weight: float = -0.5

    def applies(self, facts: RobotFacts) -> bool:
        """Return whether the base can turn."""
        return "yaw" in facts.base

    def __call__(self, step: Step) -> Array:
        """Return ``weight`` times the angle, shape ``[*]``."""
        return self.weight * _away(step, "yaw")


@dataclass(frozen=True)
class OffLine(RewardTerm):
    """Penalise the distance from the straight line, for a base that can move sideways.

    Attributes:
        weight: Per metre (1/m).
    """

    weight: float = -0.3

    def applies(self, facts: RobotFacts) -> bool:
        """Return whether the base can move sideways."""
        return "side" in facts.base

    def __call__(self, step: Step) -> Array:
        """Return ``weight`` times the distance, shape ``[*]``."""
        return self.weight * _away(step, "side")


def _away(step: Step, coordinate: str) -> Array:
    return step.xp.abs(step.now.base[..., step.facts.base.index(coordinate), 0])
