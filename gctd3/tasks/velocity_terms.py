"""Terms of the reward of a robot that follows a commanded velocity."""

from __future__ import annotations

from dataclasses import dataclass

from gctd3.errors import ConfigError, check_between
from gctd3.tasks.terms import Array, Remembered, RewardTerm, RobotFacts, Step
from gctd3.tasks.velocity_command import SWAY, VELOCITY, averaged


@dataclass(frozen=True)
class _Track(RewardTerm):
    scale: float | None = None
    within: float = 1.0
    time: float = SWAY

    def __post_init__(self) -> None:
        if self.scale is not None and not self.scale > 0:
            raise ConfigError(f"scale must be above 0, or null, got {self.scale}.")
        check_between(self, 0, 100, "within", "time")

    def remembers(self) -> tuple[Remembered, ...]:
        """Return the array of the averaged velocities."""
        return (averaged(self.time),)

    def _pay(self, step: Step, error: Array) -> Array:
        return self.weight * (self.within - error if self.scale is None else step.xp.exp(-((error / self.scale) ** 2)))

    def _off(self, step: Step) -> Array:
        # The command is the one that the policy saw when it chose the action.
        return step.after[averaged(self.time).name] - step.before[VELOCITY]


@dataclass(frozen=True)
class TrackVelocity(_Track):
    """Reward the velocity in the plane, averaged over steps, being the commanded one.

    Without a scale the pay is linear, ``weight (within - |v - c|)``: as much under each command that is followed, so
    that the value of a state hardly depends on the command, and more for each bit of speed of a robot that stands. With
    a scale it is ``weight exp(-|v - c|^2 / scale^2)`` (Rudin et al. 2022, arXiv:2109.11978), from which a robot that
    stands learns little.

    Attributes:
        weight: Reward per m/s (s/m), or the largest reward of a step.
        scale: Error at which the pay has fallen to ``1 / e`` (m/s); ``None`` for a linear pay.
        within: Error at which a linear pay is 0 (m/s).
        time: Time constant of the average, over which the body's sway is not counted (s); 0 for none.
    """

    def __call__(self, step: Step) -> Array:
        """Return the pay, shape ``[*]``."""
        xp = step.xp
        off = self._off(step)[..., :2]
        return self._pay(step, xp.sqrt(xp.sum(off * off, axis=-1)))


@dataclass(frozen=True)
class TrackYawRate(_Track):
    """Reward the yaw rate being the commanded one, as :class:`TrackVelocity` does, for a base that can yaw.

    Attributes:
        weight: Reward per rad/s (s/rad), or the largest reward of a step.
        scale: Error at which the pay has fallen to ``1 / e`` (rad/s); ``None`` for a linear pay.
        within: Error at which a linear pay is 0 (rad/s).
        time: Time constant of the average (s); 0 for none.
    """

    weight: float = 0.5

    def applies(self, facts: RobotFacts) -> bool:
        """Return whether the base can yaw."""
        return "yaw" in facts.base

    def __call__(self, step: Step) -> Array:
        """Return the pay, shape ``[*]``."""
        return self._pay(step, step.xp.abs(self._off(step)[..., 2]))


@dataclass(frozen=True)
class StandStill(RewardTerm):
    """Penalise moving joints while the command is to stand: ``weight`` times their mean absolute velocity.

    Attributes:
        weight: Reward per rad/s (s/rad).
    """

    weight: float = -0.1

    def __call__(self, step: Step) -> Array:
        """Return the penalty, 0 while the robot is to move, shape ``[*]``."""
        xp = step.xp
        stands = xp.all(step.before[VELOCITY] == 0.0, axis=-1)
        speed = xp.mean(xp.abs(step.now.velocities), axis=-1)
        return self.weight * xp.where(stands, speed, 0.0)
