"""Define terms outside the library: valid ones, and one for each way to be wrong."""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from gctd3.tasks.features import NodeFeature, Reading
from gctd3.tasks.terms import Command, Randomisation, Remembered, RewardTerm, Termination

# Right ones: follow a speed that is commanded, sense it, and end when it was missed for too long.


def _missed(before, step):
    xp = step.xp
    off = xp.abs(step.now.velocity - step.before["command.speed"][..., 0])
    return xp.where(off > 0.5, before + 1, 0)


MISSED = Remembered("missed_steps", (), 0, _missed)


@dataclass(frozen=True)
class FollowSpeed(RewardTerm):
    """Pay for a forward velocity near the commanded one, and charge for large actions."""

    weight: float = 2.0
    effort: float = 0.1

    def __call__(self, step):
        xp, asked = step.xp, step.before["command.speed"][..., 0]
        near = xp.exp(-((step.now.velocity - asked) ** 2))
        return self.weight * near - self.effort * xp.sum(step.action**2, axis=-1)


@dataclass(frozen=True)
class MissedSpeed(Termination):
    """End when the velocity was far from the commanded one for some steps."""

    steps: int = 20

    def remembers(self):
        return (MISSED,)

    def __call__(self, step):
        return step.after[MISSED.name] > self.steps

    def clock(self, after, facts, time_limit):
        return after[MISSED.name][..., None] / self.steps

    def clock_mirror(self, facts):
        return np.arange(1), np.ones(1)


@dataclass(frozen=True)
class AskedSpeed(NodeFeature):
    """Sense the commanded speed (m/s) at the root."""

    kind: ClassVar[str] = "root"

    def readings(self, robot, nodes):
        return [[Reading("asked_m_s", "the commanded speed", "command")]]

    def __call__(self, sensed):
        return sensed.memory["command.speed"][..., None, :]


# Wrong ones.


@dataclass(frozen=True)
class OfWheels(AskedSpeed):
    """Sense at nodes that no robot has."""

    kind: ClassVar[str] = "wheel"


@dataclass(frozen=True)
class TooWide(AskedSpeed):
    """Return more numbers than it says."""

    def __call__(self, sensed):
        return np.zeros((*sensed.now.position.shape, 1, 2))


@dataclass(frozen=True)
class Remembers(RewardTerm):
    """Remember something, and be worth nothing."""

    def __call__(self, step):
        return step.xp.zeros_like(step.now.velocity)


def _rising(before, step):
    return before + 1


def _doubled(before, step):
    return 2 * before


def _halved(before, step):
    return before / 2


def _summed(before, step):
    return before.sum(axis=-1)


@dataclass(frozen=True)
class WrongShape(Remembers):
    """Say that something has a number for each foot, and remember a single one."""

    def remembers(self):
        return (Remembered("sums", ("feet",), 0.0, _summed),)


@dataclass(frozen=True)
class OtherType(Remembers):
    """Begin with whole numbers and go on with fractions."""

    def remembers(self):
        return (Remembered("halves", ("feet",), 1, _halved),)


@dataclass(frozen=True)
class Rising(Remembers):
    """Remember something under a name that :class:`Doubling` uses too."""

    def remembers(self):
        return (Remembered("shared", ("feet",), 0, _rising),)


@dataclass(frozen=True)
class Doubling(Remembers):
    """Remember something else under that name."""

    def remembers(self):
        return (Remembered("shared", ("feet",), 0, _doubled),)


@dataclass(frozen=True)
class OneForAll(RewardTerm):
    """Return one number for all robots."""

    def __call__(self, step):
        return step.now.velocity.mean()


@dataclass(frozen=True)
class Numbers(Termination):
    """Return a number where true or false is asked for."""

    def __call__(self, step):
        return step.now.velocity


@dataclass(frozen=True)
class Forgetful(RewardTerm):
    """Read what nobody remembers."""

    def __call__(self, step):
        return step.after["nothing"]


@dataclass(frozen=True)
class UnmirroredClock(Termination):
    """Show critics two clocks, and do not say how they look in the mirror."""

    def __call__(self, step):
        return step.now.velocity > 100.0

    def clock(self, after, facts, time_limit):
        return np.zeros((*after["step"].shape, 2))


@dataclass(frozen=True)
class OnLegs(Remembers):
    """Remember an array of a size that has no name."""

    def remembers(self):
        return (Remembered("on_legs", ("legs",), 0.0, _rising),)


@dataclass(frozen=True)
class NotFinite(RewardTerm):
    """Divide by a speed that a standing robot does not have."""

    def __call__(self, step):
        return step.xp.zeros_like(step.now.velocity) / step.now.velocity


@dataclass(frozen=True)
class ShortPose(Randomisation):
    """Return a pose that is too short."""

    def __call__(self, rng, robot, qpos, qvel):
        return qpos[:1], qvel


@dataclass(frozen=True)
class NoPose(Randomisation):
    """Forget to return."""

    def __call__(self, rng, robot, qpos, qvel):
        qpos[0] = 0.0


@dataclass(frozen=True)
class FlatCommand(Command):
    """Draw a number for each robot, and not a row."""

    @property
    def size(self):
        return 1

    def __call__(self, rng, count):
        return rng.random(count)


@dataclass(frozen=True)
class Failing(RewardTerm):
    """Look for the fourth item of an empty list."""

    def __call__(self, step):
        return [][3]


@dataclass(frozen=True)
class FailingLater(Termination):
    """Work when it is tried, and fail in the third step of an episode."""

    def __call__(self, step):
        if (step.after["step"] > 2).any():
            raise OSError(5, "the sensor is gone")
        return step.now.velocity > 100.0


@dataclass(frozen=True)
class FeetDown(NodeFeature):
    """Count the feet on the ground, as a reading of any name and quantity."""

    kind: ClassVar[str] = "root"
    quantity: str = "contact"
    reading: str = "feet_down"

    def readings(self, robot, nodes):
        return [[Reading(self.reading, "feet on the ground", self.quantity)]]

    def __call__(self, sensed):
        return sensed.now.feet_down.sum(axis=-1)[..., None, None]


@dataclass(frozen=True)
class Nowhere(NodeFeature):
    """Do not say of which nodes it is a feature."""

    def readings(self, robot, nodes):
        return [[] for _ in nodes]

    def __call__(self, sensed):
        return sensed.now.height


@dataclass(frozen=True)
class Unread(FeetDown):
    """Say nothing of its readings."""

    def readings(self, robot, nodes):
        return None


@dataclass(frozen=True)
class Listed(Remembers):
    """Take a list and a mapping of anything."""

    speeds: list = field(default_factory=list)
    by_name: dict = field(default_factory=dict)

    def __post_init__(self):
        assert type(self.speeds) is list
        if 3 in self.speeds:
            raise ArithmeticError("no three")


@dataclass(frozen=True)
class FailingAtOnce(Remembers):
    """Work for the two robots with which it is tried, and for no others."""

    def __call__(self, step):
        return step.xp.zeros_like(step.now.velocity) + np.zeros(2)
