"""Terms of tasks: rewards, terminations, commands, randomisations, and the arrays that they remember.

A term is a small frozen dataclass with ``__call__``: a pure function over arrays whose leading dimensions ``*`` are the
robots (none for one robot, ``[N]`` for a batch). It is written to the array API standard, so that the same term runs on
NumPy arrays and on PyTorch tensors: functions come from :attr:`Step.xp`, and nothing is changed in place. A term of
your own is a class in your package and a line of YAML: ``+reward.terms.mine._target_=my_package.Mine``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from gctd3.errors import ConfigError
from gctd3.robots.actuators import torque_limit
from gctd3.robots.array_library import array_namespace
from gctd3.robots.gait_pattern import alternating_phases
from gctd3.robots.graph import KinematicGraph
from gctd3.robots.nodes import foot_slots
from gctd3.robots.robot import Robot
from gctd3.robots.sole_heights import SoleHeights
from gctd3.tasks.measurement import Measurement

if TYPE_CHECKING:
    from gctd3.tasks.ground import Ground

Array = Any  # of NumPy or of PyTorch


@dataclass(frozen=True)
class ServoFacts:
    """Hold the numbers of a robot's servos, in the order of the actions.

    Attributes:
        joints: Index of each servo's joint in ``Measurement.angles``, shape ``[A]``.
        limited: Indices of the servos with a torque limit, shape ``[L]``.
        centre: Desired angle at an action of 0, shape ``[A]`` (rad).
        scale: Change of the desired angle by an action of 1, shape ``[A]`` (rad).
        stiffness: Torque per radian, shape ``[A]`` (N m/rad).
        damping: Torque per unit of velocity, shape ``[A]`` (N m s/rad).
        effort: Torque limit, infinite for none, shape ``[A]`` (N m).
    """

    NUMBERS: ClassVar[tuple[str, ...]] = ("centre", "scale", "stiffness", "damping", "effort")

    joints: np.ndarray
    limited: np.ndarray
    centre: np.ndarray
    scale: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    effort: np.ndarray

    @classmethod
    def from_robot(cls, robot: Robot) -> ServoFacts:
        """Read the servos of a robot."""
        names, model = [joint.name for joint in robot.joints], robot.model
        centre, scale = robot.action_map
        effort = np.array([torque_limit(robot, i) for i in range(len(robot.actuated))])
        return cls(
            joints=np.array([names.index(name) for name in robot.actuated], dtype=np.int64),
            limited=np.flatnonzero(np.isfinite(effort)),
            centre=centre,
            scale=scale,
            stiffness=model.actuator_gainprm[:, 0].copy(),
            damping=-model.actuator_biasprm[:, 2],
            effort=effort,
        )


@dataclass(frozen=True)
class RobotFacts:
    """Hold the facts of a robot that terms read: counts, and indices of its joints and feet.

    Attributes:
        control_dt: Control period (s).
        joints: Number of joints ``J``.
        actions: Number of actions ``A``.
        feet: Number of feet; leg ``i`` ends in foot ``i``.
        hips: Index of each leg's hip in ``Measurement.angles``, shape ``[feet]``.
        hip_signs: Factors that make a hip's angle count in the sense of its mirror image, shape ``[feet]``.
        hip_mirror_signs: +1 if equal angles of a hip and its mirror image mirror each other, else -1, shape ``[feet]``.
        foot_pairs: Indices of the feet that mirror each other, shape ``[P, 2]``.
        mirror_feet: Index of each foot's mirror image, or its own if it has none, shape ``[feet]``.
        foot_phases: Phase of each foot in a gait in which legs take turns, shape ``[feet]`` (periods).
        base: Names of the coordinates in ``Measurement.base``.
        node_joints: Index in ``Measurement.angles`` of each joint node's joint, shape ``[J]``.
        foot_slots: Ground node of each foot, counted from the last one (-1), and place there, shape ``[feet, 2]``.
        home: Joint angles in the standing pose, shape ``[J]`` (rad).
        ranges: Lower and upper limit of each joint, infinite for none, shape ``[J, 2]`` (rad).
        leg_length: Height of the hips above the ground when standing, the mean over legs (m).
        foot_velocities: Whether the velocities of the feet are measured.
        servos: Numbers of the servos.
        ground: The terrain; ``None`` for a plane.
        soles: Heights of the soles by the joints' angles; ``None`` if a leg has a joint whose angle is not measured.
    """

    control_dt: float
    joints: int
    actions: int
    feet: int
    hips: np.ndarray
    hip_signs: np.ndarray
    hip_mirror_signs: np.ndarray
    foot_pairs: np.ndarray
    mirror_feet: np.ndarray
    foot_phases: np.ndarray
    base: tuple[str, ...]
    node_joints: np.ndarray
    foot_slots: np.ndarray
    home: np.ndarray
    ranges: np.ndarray
    leg_length: float
    foot_velocities: bool
    servos: ServoFacts
    ground: Ground | None = None
    soles: SoleHeights | None = None

    @classmethod
    def from_robot(
        cls, robot: Robot, graph: KinematicGraph, control_dt: float, ground: Ground | None = None
    ) -> RobotFacts:
        """Build the facts of a robot, the nodes of its graph and its terrain."""
        names = [joint.name for joint in robot.joints]
        pairs = [(i, k) for i, k in enumerate(robot.mirror_feet) if i < k]
        return cls(
            control_dt=control_dt,
            joints=len(names),
            actions=len(robot.actuated),
            feet=len(robot.feet),
            hips=np.array([names.index(hip.name) for hip in robot.hips]),
            hip_signs=robot.hip_signs,
            hip_mirror_signs=np.array([robot.mirror_sign(hip.name) for hip in robot.hips]),
            foot_pairs=np.array(pairs, dtype=np.int64).reshape(-1, 2),
            mirror_feet=np.array(robot.mirror_feet),
            foot_phases=alternating_phases(robot),
            base=robot.base.extra,
            node_joints=np.array([names.index(name) for name in graph.nodes if name in names]),
            foot_slots=foot_slots(robot),
            home=robot.home_angles,
            ranges=np.array([joint.range for joint in robot.joints]),
            leg_length=robot.leg_length,
            foot_velocities=robot.foot_velocity_sensors is not None,
            servos=ServoFacts.from_robot(robot),
            ground=ground,
            soles=SoleHeights.of(robot),
        )

    def soft_range(self, share: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the ends of a share of each joint's range about its middle, infinite for none, each ``[J]`` (rad)."""
        low, high = self.ranges.T
        limited = np.isfinite(high - low)
        # Half a range at a time: one end of none is minus infinity, and their sum no number.
        low, high = np.where(limited, low, 0.0), np.where(limited, high, 0.0)
        middle, half = (low + high) / 2, np.where(limited, share * (high - low) / 2, np.inf)
        return middle - half, middle + half

    def size(self, dimension: int | str) -> int:
        """Return the size of a remembered array's dimension: a number, or ``feet``, ``joints`` or ``actions``."""
        if isinstance(dimension, int):
            return dimension
        if dimension not in ("feet", "joints", "actions"):
            raise ConfigError(f"a remembered size must be a number, feet, joints or actions, got {dimension!r}.")
        return int(getattr(self, dimension))


@dataclass(frozen=True)
class Step:
    """Hold the inputs of terms in one control step.

    Attributes:
        now: Measurement after the step.
        before: Memory before the step, by name.
        after: Memory after the step, by name; incomplete while it is computed.
        action: Action in [-1, 1], shape ``[*, A]``.
        diverged: Whether the simulation failed, shape ``[*]``.
        facts: Facts of the robot.
        ended: Whether each termination holds, by name, shape ``[*]`` each; incomplete while they are computed.
    """

    now: Measurement
    before: Mapping[str, Array]
    after: Mapping[str, Array]
    action: Array
    diverged: Array
    facts: RobotFacts
    ended: Mapping[str, Array]

    @cached_property
    def xp(self) -> Any:  # noqa: ANN401 - a module
        """Return the namespace of the step's array library, with the names of the array API standard."""
        return array_namespace(self.now.angles)

    def constant(self, values: np.ndarray, like: Array) -> Array:
        """Convert a constant array to the step's library, with the type of ``like`` unless of integers or bools."""
        kind = None if values.dtype.kind in "iub" else like.dtype
        return self.xp.asarray(values, dtype=kind)

    @cached_property
    def hips(self) -> Array:
        """Return the angles of the hips, one for each leg, shape ``[*, feet]`` (rad)."""
        return hips(self.now, self.facts)


def hips(now: Measurement, facts: RobotFacts) -> Array:
    """Return the angles of the hips, one for each leg, shape ``[*, feet]`` (rad)."""
    xp = array_namespace(now.angles)
    return xp.take(now.angles, xp.asarray(facts.hips), axis=-1)


@dataclass(frozen=True)
class Remembered:
    """Declare an array that the environment keeps for a term between steps, resets with the episode and checkpoints.

    Terms that declare the same array share it; different arrays of one name are refused.

    Attributes:
        name: Name of the array in ``Step.before`` and ``Step.after``.
        shape: Shape without the robots' dimensions; ``feet``, ``joints`` and ``actions`` stand for their numbers.
        start: Value at a reset: a number, or a function of the measurement at the reset and the robot's facts.
        update: Function of the array before the step and the step; returns the array after it. Its type stays.
        lasting: Whether a reset keeps the array of the robot's last episode, as a curriculum does.
    """

    name: str
    shape: Sequence[int | str]
    start: float | bool | Callable[[Measurement, RobotFacts], Array]
    update: Callable[[Array, Step], Array]
    lasting: bool = False

    def begin(self, now: Measurement, facts: RobotFacts) -> Array:
        """Return the value at a reset, shape ``[*, shape]``."""
        if callable(self.start):
            return self.start(now, facts)
        xp = array_namespace(now.position)
        kind = {bool: xp.bool, int: xp.int64}.get(type(self.start), now.position.dtype)
        return xp.full((*now.position.shape, *map(facts.size, self.shape)), self.start, dtype=kind)


def recent(quantity: str, length: int, *shape: int | str) -> Remembered:
    """Declare the array of the last values of a measured quantity, oldest first; a reset repeats the first value.

    Args:
        quantity: Field of :class:`.Measurement`.
        length: Number of values.
        shape: Shape of one value.
    """
    return Remembered(f"{quantity}[{length}]", (length, *shape), _RepeatFirst(quantity, length), _PushNewest(quantity))


# Dataclasses, not nested functions: arrays declared alike by two terms must compare equal.
@dataclass(frozen=True)
class _RepeatFirst:
    quantity: str
    length: int

    def __call__(self, now: Measurement, facts: RobotFacts) -> Array:
        value = getattr(now, self.quantity)
        return array_namespace(value).stack([value] * self.length, axis=now.position.ndim)


@dataclass(frozen=True)
class _PushNewest:
    quantity: str

    def __call__(self, before: Array, step: Step) -> Array:
        value, axis = getattr(step.now, self.quantity), step.now.position.ndim
        robots = (slice(None),) * axis
        return step.xp.concat([before[(*robots, slice(1, None))], value[(*robots, None)]], axis=axis)


@dataclass(frozen=True)
class Term(ABC):  # noqa: B024 - each kind of term defines its own call
    """Represent a part of a task."""

    def remembers(self) -> tuple[Remembered, ...]:
        """Return the arrays that the term needs from step to step."""
        return ()

    def reads(self) -> tuple[str, ...]:
        """Return the names of the terminations that the term reads from ``Step.ended``."""
        return ()

    def applies(self, facts: RobotFacts) -> bool:
        """Return whether the term applies to the robot; a term that does not apply is left out."""
        return True


@dataclass(frozen=True)
class RewardTerm(Term):
    """Represent a term of the reward.

    Attributes:
        weight: Factor; negative for a penalty.
    """

    weight: float = 1.0

    @abstractmethod
    def __call__(self, step: Step) -> Array:
        """Return the term's reward of the step, the weight included, shape ``[*]``."""


@dataclass(frozen=True)
class Termination(Term):
    """Terminate an episode on a condition.

    Class attributes:
        truncates: Whether the value of the last state is bootstrapped, as at a time limit.
        succeeds: Whether the termination is a success of the task.
        fatal: Whether the robot could not continue after it, as after a fall.
    """

    truncates: ClassVar[bool] = False
    succeeds: ClassVar[bool] = False
    fatal: ClassVar[bool] = False

    @abstractmethod
    def __call__(self, step: Step) -> Array:
        """Return whether the termination holds, bool of shape ``[*]``."""

    def clock(self, after: Mapping[str, Array], facts: RobotFacts, time_limit: int) -> Array | None:
        """Return the progress towards the termination, shape ``[*, K]``, for critics only; ``None`` if not time-based.

        Args:
            after: Memory after the step.
            facts: Facts of the robot.
            time_limit: Longest episode (control steps), the scale of a termination without a limit of its own.
        """
        return None

    def clock_mirror(self, facts: RobotFacts) -> tuple[np.ndarray, np.ndarray]:
        """Return source and sign, each ``[K]``: ``sign * clock[..., source]`` is the mirrored robot's clock."""
        return np.zeros(0, dtype=np.int64), np.zeros(0)


@dataclass(frozen=True)
class Command(Term):
    """Draw a command to the robot at regular intervals; terms and features read it by its name.

    Attributes:
        every: Time after which the command is drawn anew (s).
    """

    every: float = 5.0

    def __post_init__(self) -> None:
        if not self.every > 0:
            raise ConfigError(f"every must be above 0 s, got {self.every}.")

    @property
    @abstractmethod
    def size(self) -> int:
        """Return the length ``K`` of the command."""

    @abstractmethod
    def __call__(self, rng: np.random.Generator | np.random.RandomState, count: int) -> np.ndarray:
        """Draw a command for each of ``count`` robots, shape ``[count, K]``."""

    def draw(
        self, rng: np.random.Generator | np.random.RandomState, count: int, memory: Mapping[str, Array]
    ) -> np.ndarray:
        """Draw a command for each robot of a memory, shape ``[count, K]``; a curriculum reads its arrays there."""
        return self(rng, count)

    @property
    def slew_rates(self) -> np.ndarray | None:
        """Return by how much each number changes a second at most, shape ``[K]``; ``None`` for a command that jumps.

        With rates an episode begins with the command :attr:`still`, and each drawn one is approached.
        """
        return None

    @property
    def still(self) -> np.ndarray:
        """Return the command of a robot that is at rest, shape ``[K]``."""
        return np.zeros(self.size)

    def fitted(self, facts: RobotFacts) -> Command:
        """Return the command for a robot, such as one without what its base cannot do."""
        return self

    def evaluated(self) -> Command:
        """Return the command of evaluations, such as one without a curriculum."""
        return self


def period(every: float, control_dt: float) -> int:
    """Return the control steps for which a command holds that is drawn anew every so many seconds, at least one."""
    return max(1, round(every / control_dt))


@dataclass(frozen=True)
class Randomisation(Term):
    """Randomise the initial state of an episode."""

    @abstractmethod
    def __call__(
        self, rng: np.random.Generator | np.random.RandomState, robot: Robot, qpos: np.ndarray, qvel: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the initial pose ``[nq]`` and velocities ``[nv]`` of one robot."""
