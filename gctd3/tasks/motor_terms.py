"""Terms of the reward that real motors and joints need: smooth actions, little torque, no end stops, no slipping.

mjlab (1.6) and MuJoCo Playground (0.2) have the same kinds of terms in their tasks of legged robots.
"""

from __future__ import annotations

from dataclasses import dataclass

from gctd3.errors import ConfigError
from gctd3.tasks.terms import Array, Remembered, RewardTerm, RobotFacts, Step


def _action(before: Array, step: Step) -> Array:
    return step.xp.asarray(step.action, dtype=before.dtype)


# The last action, shape [*, actions].
LAST_ACTION = Remembered("last_action", ("actions",), 0.0, _action)


@dataclass(frozen=True)
class ActionRate(RewardTerm):
    """Penalise changes of the action from one control step to the next."""

    weight: float = -0.1

    def remembers(self) -> tuple[Remembered, ...]:
        """Return the array of the last action."""
        return (LAST_ACTION,)

    def __call__(self, step: Step) -> Array:
        """Return ``weight * mean((a_t - a_(t-1))^2)``, shape ``[*]``."""
        change = step.after[LAST_ACTION.name] - step.before[LAST_ACTION.name]
        return self.weight * step.xp.mean(change * change, axis=-1)


@dataclass(frozen=True)
class Effort(RewardTerm):
    """Penalise torque, of the servos with a torque limit.

    The torque is that of the servo's law at the end of the step, ``stiffness (desired - angle) - damping velocity``.
    """

    weight: float = -0.2

    def applies(self, facts: RobotFacts) -> bool:
        """Return whether a servo has a torque limit."""
        return len(facts.servos.limited) > 0

    def __call__(self, step: Step) -> Array:
        """Return ``weight * mean(min(|tau| / limit, 1)^2)``, shape ``[*]``."""
        xp, servos = step.xp, step.facts.servos
        angles, velocities = (
            xp.take(values, xp.asarray(servos.joints), axis=-1) for values in (step.now.angles, step.now.velocities)
        )
        constant = {name: step.constant(getattr(servos, name), angles) for name in servos.NUMBERS}
        action = xp.clip(xp.asarray(step.action, dtype=angles.dtype), -1.0, 1.0)
        desired = constant["centre"] + constant["scale"] * action
        torque = constant["stiffness"] * (desired - angles) - constant["damping"] * velocities
        share = xp.clip(xp.abs(torque) / constant["effort"], 0.0, 1.0)
        used = xp.take(share, xp.asarray(servos.limited), axis=-1)
        return self.weight * xp.mean(used * used, axis=-1)


@dataclass(frozen=True)
class EndStops(RewardTerm):
    """Penalise angles near the ends of the joints' ranges: ``weight`` times the sum of the excess angles.

    Attributes:
        weight: Reward per radian of excess (1/rad).
        share: Share of a range, about its middle, that is free.
    """

    weight: float = -1.0
    share: float = 0.95

    def __post_init__(self) -> None:
        if not 0 < self.share <= 1:
            raise ConfigError(f"share must be above 0 and at most 1, got {self.share}.")

    def __call__(self, step: Step) -> Array:
        """Return ``weight * sum(max(0, low - q, q - high))``, shape ``[*]``."""
        xp, angles = step.xp, step.now.angles
        low, high = (step.constant(end, angles) for end in step.facts.soft_range(self.share))
        excess = xp.maximum(low - angles, angles - high)
        return self.weight * xp.sum(xp.where(excess > 0.0, excess, 0.0), axis=-1)


@dataclass(frozen=True)
class HomePose(RewardTerm):
    """Penalise the distance of the joints from the standing pose.

    Attributes:
        weight: Reward per squared radian (1/rad^2).
    """

    weight: float = -0.5

    def __call__(self, step: Step) -> Array:
        """Return ``weight * mean((q - q_home)^2)``, shape ``[*]``."""
        away = step.now.angles - step.constant(step.facts.home, step.now.angles)
        return self.weight * step.xp.mean(away * away, axis=-1)


@dataclass(frozen=True)
class FootSlip(RewardTerm):
    """Penalise feet that slide while they are down, on robots whose feet have velocity sensors.

    Attributes:
        weight: Reward per m/s of a foot (s/m).
    """

    weight: float = -0.2

    def applies(self, facts: RobotFacts) -> bool:
        """Return whether the velocities of the feet are measured."""
        return facts.foot_velocities

    def __call__(self, step: Step) -> Array:
        """Return ``weight * sum(|v_xy|)`` over the feet that are down, shape ``[*]``."""
        xp, now = step.xp, step.now
        speed = xp.sqrt(xp.sum(now.feet_velocity[..., :2] ** 2, axis=-1))
        return self.weight * xp.sum(xp.where(now.feet_down, speed, 0.0), axis=-1)


@dataclass(frozen=True)
class ShankContact(RewardTerm):
    """Penalise each step in which a shank touches the ground."""

    weight: float = -0.5

    def __call__(self, step: Step) -> Array:
        """Return ``weight`` where a shank is on the ground, else 0, shape ``[*]``."""
        return self.weight * step.xp.astype(step.now.shank_down, step.now.velocity.dtype)


@dataclass(frozen=True)
class HeightFromStanding(RewardTerm):
    """Penalise the distance of the body's height from standing, in leg lengths.

    Attributes:
        weight: Reward per leg length.
        free: Distance without a penalty, as a share of the leg's length.
    """

    weight: float = -2.0
    free: float = 0.15

    def __call__(self, step: Step) -> Array:
        """Return ``weight * max(0, |z| / leg_length - free)``, shape ``[*]``."""
        xp = step.xp
        excess = xp.abs(step.now.height) / step.facts.leg_length - self.free
        return self.weight * xp.where(excess > 0.0, excess, 0.0)
