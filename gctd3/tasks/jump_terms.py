"""Terms of a jump: what its height, the landing and the place are worth, and when it is done."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from gctd3.errors import ConfigError, check_between
from gctd3.tasks.heading import coordinate
from gctd3.tasks.jump_command import HEIGHT
from gctd3.tasks.jump_memory import APEX, ARRAYS, STOOD, standing
from gctd3.tasks.terminations import STEPS, TimeLimit
from gctd3.tasks.terms import Array, Remembered, RewardTerm, Step


@dataclass(frozen=True)
class JumpHeight(RewardTerm):
    """Reward each step that brings the apex nearer to the commanded height, and penalise one that exceeds it.

    ``weight (|c - a_(t-1)| - |c - a_t|) / h`` with the apex ``a`` of the episode so far, the commanded height ``h`` and
    ``c = h + margin``: over an episode ``weight`` for a jump of just that height, whatever it is.

    Attributes:
        weight: Reward of a jump of the commanded height.
        margin: Height above the commanded one at which a jump is aimed, so that it is at least that high (m).
    """

    weight: float = 10.0
    margin: float = 0.025

    def __post_init__(self) -> None:
        if not 0 <= self.margin < 1:
            raise ConfigError(f"margin must be at least 0 m and below 1 m, got {self.margin}.")

    def remembers(self) -> tuple[Remembered, ...]:
        """Return the arrays of the jump."""
        return ARRAYS

    def __call__(self, step: Step) -> Array:
        """Return ``weight (|c - a_(t-1)| - |c - a_t|) / h``, shape ``[*]``."""
        xp, height = step.xp, step.before[HEIGHT][..., 0]
        aim = height + self.margin
        before, after = step.before[APEX.name], step.after[APEX.name]
        return self.weight * (xp.abs(aim - before) - xp.abs(aim - after)) / height


@dataclass(frozen=True)
class StandAfterJump(RewardTerm):
    """Reward each step in which the robot stands after a jump, by how high that was.

    It is ``weight s exp(-mean(|w|) / speed)`` with the joints' velocities ``w``, and ``s = 1`` after a jump of at least
    the commanded height ``h``, ``short (a / h)^2`` after one with a lower apex ``a``: nothing before a jump, and less
    while joints still move.

    Attributes:
        weight: Reward of a step in which nothing moves, after a jump of the commanded height.
        speed: Mean joint velocity at which the pay has fallen to ``1 / e`` (rad/s).
        short: Share of it after a jump that is all but high enough.
    """

    weight: float = 0.2
    speed: float = 2.0
    short: float = 0.5

    def __post_init__(self) -> None:
        check_between(self, 0, 1, "short")
        if not self.speed > 0:
            raise ConfigError(f"speed must be above 0 rad/s, got {self.speed}.")

    def remembers(self) -> tuple[Remembered, ...]:
        """Return the arrays of the jump."""
        return ARRAYS

    def __call__(self, step: Step) -> Array:
        """Return ``weight s exp(-mean(|w|) / speed)`` where the robot stands, else 0, shape ``[*]``."""
        xp = step.xp
        share = step.after[APEX.name] / step.before[HEIGHT][..., 0]
        share = xp.where(share >= 1.0, 1.0, self.short * share * share)
        moving = xp.mean(xp.abs(step.now.velocities), axis=-1)
        pay = share * xp.exp(-moving / self.speed)
        return self.weight * xp.where(standing(step.now, step.facts), pay, 0.0)


@dataclass(frozen=True)
class LeaveSpot(RewardTerm):
    """Penalise the distance of the body from where the episode began.

    Attributes:
        weight: Reward per metre (1/m).
    """

    weight: float = -0.05

    def __call__(self, step: Step) -> Array:
        """Return ``weight`` times the distance along the ground, shape ``[*]``."""
        side = coordinate(step.now, step.facts, "side")
        return self.weight * step.xp.sqrt(step.now.position**2 + side**2)


@dataclass(frozen=True)
class JumpedAndStood(TimeLimit):
    """End the episode successfully at a time limit up to which the robot has stood after a jump that was high enough.

    The value is bootstrapped. The task needs a :class:`.TimeLimit` of as many steps beside it, for all other episodes.

    Attributes:
        steps: Time limit (control steps).
        seconds: Time for which it has to have stood without a break (s).
    """

    succeeds: ClassVar[bool] = True

    # A crouch, a jump, and a second of standing, with time to spare.
    steps: int = 130
    seconds: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.seconds <= 1000:
            raise ConfigError(f"seconds must be above 0 s and at most 1000 s, got {self.seconds}.")

    def remembers(self) -> tuple[Remembered, ...]:
        """Return the arrays of the jump."""
        return ARRAYS

    def __call__(self, step: Step) -> Array:
        """Return whether the time limit is reached and it has stood for long enough, shape ``[*]``."""
        enough = step.after[STOOD.name] >= max(1, round(self.seconds / step.facts.control_dt))
        return (step.after[STEPS] >= self.steps) & enough
