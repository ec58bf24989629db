"""Terms of the walking reward; their defaults are the paper's numbers.

Source: Phan Bui et al. 2022, Table 3, and the training script that the paper's authors released;
``conf/reward/paper.yaml`` names the source of each number.
"""

from __future__ import annotations

from dataclasses import dataclass

from gctd3.errors import ConfigError, check_between
from gctd3.robots.gait_pattern import GRAVITY
from gctd3.tasks.gait_memory import AIR_STEPS
from gctd3.tasks.terms import Array, Remembered, RewardTerm, RobotFacts, Step, recent


@dataclass(frozen=True)
class ForwardVelocity(RewardTerm):
    """Reward forward velocity up to a target (Table 3).

    Attributes:
        target: Velocity above which the reward is constant (m/s); ``None`` for that of :attr:`froude`.
        froude: Froude number ``v^2 / (g L)`` of the target for legs of length ``L`` (Alexander 1984): animals of all
            sizes walk below about 0.5. Used where ``target`` is ``None``.
    """

    target: float | None = 0.9
    froude: float = 0.3

    def __post_init__(self) -> None:
        if not self.froude > 0:
            raise ConfigError(f"froude must be above 0, got {self.froude}.")

    def __call__(self, step: Step) -> Array:
        """Return ``weight * min(v, target)``, shape ``[*]``."""
        velocity, target = step.now.velocity, self.target
        if target is None:
            target = (self.froude * GRAVITY * step.facts.leg_length) ** 0.5
        return self.weight * step.xp.minimum(velocity, step.xp.asarray(target, dtype=velocity.dtype))


@dataclass(frozen=True)
class Progress(RewardTerm):
    """Reward the distance covered over the last steps (Table 3).

    Attributes:
        weight: Reward per metre (1/m).
        steps: Number of steps ``h`` (control steps).
    """

    weight: float = 0.2
    steps: int = 5

    def __post_init__(self) -> None:
        check_between(self, 1, 1000, "steps")

    def remembers(self) -> tuple[Remembered, ...]:
        """Return the array of the last ``h + 1`` positions."""
        return (recent("position", self.steps + 1),)

    def __call__(self, step: Step) -> Array:
        """Return ``weight * (y_t - y_(t-h))``, shape ``[*]``."""
        positions = step.after[f"position[{self.steps + 1}]"]
        return self.weight * (positions[..., -1] - positions[..., 0])


@dataclass(frozen=True)
class BodyHeight(RewardTerm):
    """Penalise the distance of the body from its target height, summed over stacked frames (Table 3).

    Frames without ground contact are not penalised here.

    Attributes:
        weight: Reward ``-c1`` per metre and frame (1/m).
        single: Target height in single support (m from standing).
        double: Target height with more feet on the ground (m from standing).
        frames: Number of stacked frames.
    """

    weight: float = -0.005
    single: float = -0.010
    double: float = -0.025
    frames: int = 5

    def __post_init__(self) -> None:
        check_between(self, 1, 1000, "frames")

    def remembers(self) -> tuple[Remembered, ...]:
        """Return the arrays of the stacked frames' heights and contacts."""
        return recent("height", self.frames), recent("feet_down", self.frames, "feet")

    def __call__(self, step: Step) -> Array:
        """Return ``weight * sum(|z - target|)`` over the stacked frames with a foot down, shape ``[*]``."""
        xp, heights = step.xp, step.after[f"height[{self.frames}]"]
        feet = xp.sum(step.after[f"feet_down[{self.frames}]"], axis=-1)
        target = xp.where(feet == 1, self.single, self.double)
        return self.weight * xp.sum(xp.where(feet > 0, xp.abs(heights - target), 0.0), axis=-1)


@dataclass(frozen=True)
class Flight(RewardTerm):
    """Penalise stacked frames without ground contact (released script).

    Attributes:
        weight: Reward per frame.
        free: Number of such frames without a penalty.
        frames: Number of stacked frames.
    """

    weight: float = -0.01
    free: int = 0
    frames: int = 5

    def __post_init__(self) -> None:
        check_between(self, 1, 1000, "frames")
        check_between(self, 0, 1000, "free")

    def remembers(self) -> tuple[Remembered, ...]:
        """Return the array of the stacked frames' contacts."""
        return (recent("feet_down", self.frames, "feet"),)

    def __call__(self, step: Step) -> Array:
        """Return ``weight * max(0, n - free)`` for ``n`` stacked frames in flight, shape ``[*]``."""
        xp = step.xp
        feet = xp.sum(step.after[f"feet_down[{self.frames}]"], axis=-1)
        up = xp.sum(feet == 0, axis=-1) - self.free
        return self.weight * xp.where(up > 0, up, 0)


@dataclass(frozen=True)
class Living(RewardTerm):
    """Reward each step, or penalise it with a negative weight (released script)."""

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
        """Return the name of the termination."""
        return (self.by,)

    def __call__(self, step: Step) -> Array:
        """Return ``weight`` where the termination holds, else 0, shape ``[*]``."""
        return self.weight * step.xp.astype(step.ended[self.by], step.now.velocity.dtype)


@dataclass(frozen=True)
class Antiphase(RewardTerm):
    """Penalise the absolute sum of a left and a right leg's hip angles, which is zero when they are opposite.

    Attributes:
        weight: Reward per radian (1/rad).
    """

    weight: float = -0.3

    def __call__(self, step: Step) -> Array:
        """Return ``weight * sum(|q_left + q_right|)`` over the pairs of legs, shape ``[*]``."""
        xp, facts, hips = step.xp, step.facts, step.hips
        hips = hips * step.constant(facts.hip_signs, hips)
        first, second = (xp.take(hips, xp.asarray(feet), axis=-1) for feet in facts.foot_pairs.T)
        return self.weight * xp.sum(xp.abs(first + second), axis=-1)


@dataclass(frozen=True)
class SingleSupport(RewardTerm):
    """Reward each step with exactly one foot on the ground."""

    weight: float = 0.1

    def __call__(self, step: Step) -> Array:
        """Return ``weight`` where one foot is on the ground, else 0, shape ``[*]``."""
        xp = step.xp
        return self.weight * xp.astype(xp.sum(step.now.feet_down, axis=-1) == 1, step.now.velocity.dtype)


@dataclass(frozen=True)
class Overspeed(RewardTerm):
    """Penalise forward velocity above a bound.

    Attributes:
        weight: Reward per m/s above the bound (s/m).
        above: The bound (m/s).
    """

    weight: float = -1.0
    above: float = 1.2

    def __call__(self, step: Step) -> Array:
        """Return ``weight * max(0, v - above)``, shape ``[*]``."""
        excess = step.now.velocity - self.above
        return self.weight * step.xp.where(excess > 0.0, excess, 0.0)


@dataclass(frozen=True)
class SwingTime(RewardTerm):
    """Penalise, at a foot's touchdown, a swing time that is too short or too long.

    The term follows ``feet_air_time`` of Rudin et al. 2022 (arXiv:2109.11978), which rewards longer times.

    Attributes:
        weight: Reward per second too short or too long (1/s).
        least: Shortest swing time without a penalty (s).
        most: Longest swing time without a penalty (s).
    """

    weight: float = -12.0
    least: float = 0.34
    most: float = 0.36

    def __post_init__(self) -> None:
        if not 0 <= self.least <= self.most:
            raise ConfigError(f"least must be at least 0 s and at most most, got {self.least} and {self.most}.")

    def remembers(self) -> tuple[Remembered, ...]:
        """Return the array of each foot's swing time."""
        return (AIR_STEPS,)

    def __call__(self, step: Step) -> Array:
        """Return ``weight * sum(max(0, least - t, t - most))`` over the feet that touch down, shape ``[*]``."""
        xp, before = step.xp, step.before[AIR_STEPS.name]
        in_air = before * step.facts.control_dt
        short, long = self.least - in_air, in_air - self.most
        off = xp.where(short > 0.0, short, 0.0) + xp.where(long > 0.0, long, 0.0)
        touchdown = step.now.feet_down & (before > 0)
        # The weight is inside the sum, since to multiply the sum by it would differ in the last bit.
        return xp.sum(xp.where(touchdown, self.weight * off, 0.0), axis=-1)


@dataclass(frozen=True)
class Tilt(RewardTerm):
    """Penalise the angle between the body's vertical and the world's; a boom holds it at zero.

    Attributes:
        weight: Reward per radian (1/rad).
    """

    weight: float = -0.5

    def __call__(self, step: Step) -> Array:
        """Return ``weight * tilt``, shape ``[*]``."""
        return self.weight * step.now.tilt


@dataclass(frozen=True)
class Heading(RewardTerm):
    """Penalise the yaw angle from the forward axis, for a base that can yaw.

    Attributes:
        weight: Reward per radian (1/rad).
    """

    weight: float = -0.5

    def applies(self, facts: RobotFacts) -> bool:
        """Return whether the base can yaw."""
        return "yaw" in facts.base

    def __call__(self, step: Step) -> Array:
        """Return ``weight * |yaw|``, shape ``[*]``."""
        return self.weight * _away(step, "yaw")


@dataclass(frozen=True)
class OffLine(RewardTerm):
    """Penalise the lateral distance from the straight line, for a base that can move sideways.

    Attributes:
        weight: Reward per metre (1/m).
    """

    weight: float = -0.3

    def applies(self, facts: RobotFacts) -> bool:
        """Return whether the base can move sideways."""
        return "side" in facts.base

    def __call__(self, step: Step) -> Array:
        """Return ``weight * |side|``, shape ``[*]``."""
        return self.weight * _away(step, "side")


def _away(step: Step, coordinate: str) -> Array:
    return step.xp.abs(step.now.base[..., step.facts.base.index(coordinate), 0])
