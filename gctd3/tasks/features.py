"""Features of the nodes of a robot's graph.

The paper's task has two features a node (section 2.3): height and forward velocity of the root, angle and velocity of a
joint, the contacts of the feet on the ground. A feature of your own is a class in your package and a line of YAML:
``+task.features.mine._target_=my_package.Mine``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

import numpy as np

from gctd3.robots.floating_base import EXTRA
from gctd3.robots.nodes import foot_slots
from gctd3.robots.robot import Robot
from gctd3.tasks.measurement import Measurement
from gctd3.tasks.sensors import Source
from gctd3.tasks.terms import Remembered, RobotFacts

Quantity = Literal[
    "angle", "angular velocity", "length", "velocity", "contact", "command", "direction", "action", "ground"
]
QUANTITIES: tuple[str, ...] = get_args(Quantity)
KINDS = ("root", "base", "joint", "ground")  # of nodes


@dataclass(frozen=True)
class Reading:
    """Describe one sensor reading of a node.

    Attributes:
        name: Name with its unit, such as ``angle_hip_right_rad``, for the robot's software.
        meaning: Meaning in words.
        quantity: Measured quantity, which determines the size of the sensor's error.
        sign: +1 if the reading keeps its sign in the mirror, -1 if not.
        zero: Value of the reading at which the feature is 0, in the reading's unit.
        source: Sensor that gives the reading on a real robot.
        frequency: Of a clock, ``sin(2 pi (frequency t + phase))`` at the time ``t`` since the episode's start (Hz).
        phase: Of the same (periods).
    """

    name: str
    meaning: str
    quantity: Quantity
    sign: float = 1.0
    zero: float = 0.0
    source: Source = "not stated"
    frequency: float = 0.0
    phase: float = 0.0


@dataclass(frozen=True)
class Sensed:
    """Hold the inputs of features.

    Attributes:
        now: The measurement.
        memory: Memory of the task, including its commands.
        facts: Facts of the robot.
    """

    now: Measurement
    memory: Mapping[str, np.ndarray]
    facts: RobotFacts


@dataclass(frozen=True)
class NodeFeature(ABC):
    """Compute a feature of every node of one kind.

    Class attributes:
        kind: Kind of node: ``root``, ``base``, ``joint`` or ``ground``.
    """

    kind: ClassVar[str]

    @abstractmethod
    def readings(self, robot: Robot, nodes: tuple[str, ...]) -> list[list[Reading | None]]:
        """Return the readings of each node; ``None`` for a number that is always 0.

        Args:
            robot: The robot.
            nodes: Names of its nodes of this kind, in order.
        """

    @abstractmethod
    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return the values, shape ``[*, nodes of the kind, numbers of a node]``."""

    def remembers(self) -> tuple[Remembered, ...]:
        """Return the arrays that the feature needs from step to step, which are in ``Sensed.memory``."""
        return ()

    def check(self, facts: RobotFacts) -> None:  # noqa: B027 - most fit any
        """Raise a :class:`.ConfigError` if the feature does not fit the robot or its ground."""

    def deviation(self) -> float:
        """Return the standard deviation of each number's own error in a frame, beside those of its quantity."""
        return 0.0

    def evaluated(self) -> NodeFeature:
        """Return the feature of evaluations, such as one without noise."""
        return self

    def mirror_places(self, robot: Robot, nodes: tuple[str, ...]) -> np.ndarray | None:
        """Return the source (node, number) of each number of the mirrored robot, shape ``[nodes, numbers, 2]``.

        ``None`` stands for the same number of the node's mirror image.
        """
        return None


@dataclass(frozen=True)
class Height(NodeFeature):
    """Measure the body's height from standing (m) at the root."""

    kind: ClassVar[str] = "root"

    def readings(self, robot: Robot, nodes: tuple[str, ...]) -> list[list[Reading | None]]:
        """Return the reading of the height."""
        return [
            [Reading("height_m", "height of the root body, 0 when the robot stands", "length", source=_exact(robot))]
        ]

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return the height, shape ``[*, 1, 1]``."""
        return sensed.now.height[..., None, None]


@dataclass(frozen=True)
class Velocity(NodeFeature):
    """Measure the body's forward velocity (m/s) at the root."""

    kind: ClassVar[str] = "root"

    def readings(self, robot: Robot, nodes: tuple[str, ...]) -> list[list[Reading | None]]:
        """Return the reading of the velocity."""
        return [[Reading("velocity_m_s", "forward velocity of the root body", "velocity", source=_exact(robot))]]

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return the velocity, shape ``[*, 1, 1]``."""
        return sensed.now.velocity[..., None, None]


# Coordinates of a base beside forward and up: the unit and the meaning of each.
COORDINATES = {
    "pitch": ("rad", "pitch of the root body from standing, nose down is positive"),
    "roll": ("rad", "roll of the root body from standing, right side down is positive"),
    "yaw": ("rad", "yaw of the root body from standing, to the left is positive"),
    "side": ("m", "place of the root body to the left of where it starts"),
}
GRAVITY = ("pitch", "roll")  # coordinates that an IMU measures by the direction of gravity


def _exact(robot: Robot) -> Source:
    """Return the source of the root's exact height, place and speed."""
    return "simulator" if robot.base.free else "boom encoder"


@dataclass(frozen=True)
class BaseCoordinate(NodeFeature):
    """Measure each coordinate of the base beside position and height, from standing (rad; ``side`` m)."""

    kind: ClassVar[str] = "base"

    def readings(self, robot: Robot, nodes: tuple[str, ...]) -> list[list[Reading | None]]:
        """Return the readings of the coordinates, one a node."""
        rows: list[list[Reading | None]] = []
        for name in robot.base.extra:
            unit, meaning = COORDINATES[name]
            quantity: Quantity = "angle" if unit == "rad" else "length"
            source: Source = "IMU orientation" if name in GRAVITY else "simulator"
            source = source if robot.base.free else "boom encoder"
            rows.append([Reading(f"{name}_{unit}", meaning, quantity, EXTRA[name], source=source)])
        return rows

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return the coordinates, shape ``[*, nodes, 1]``."""
        return sensed.now.base[..., :1]


@dataclass(frozen=True)
class BaseRate(NodeFeature):
    """Measure the rate of each coordinate of the base beside position and height (rad/s; ``side`` m/s)."""

    kind: ClassVar[str] = "base"

    def readings(self, robot: Robot, nodes: tuple[str, ...]) -> list[list[Reading | None]]:
        """Return the readings of the rates, one a node."""
        rows: list[list[Reading | None]] = []
        for name in robot.base.extra:
            unit, _ = COORDINATES[name]
            meaning = "its rate, as a gyroscope on the body measures it" if unit == "rad" else "its rate"
            quantity: Quantity = "angular velocity" if unit == "rad" else "velocity"
            source: Source = "IMU gyroscope" if unit == "rad" else _exact(robot)
            rows.append([Reading(f"{name}_rate_{unit}_s", meaning, quantity, EXTRA[name], source=source)])
        return rows

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return the rates, shape ``[*, nodes, 1]``."""
        return sensed.now.base[..., 1:]


@dataclass(frozen=True)
class JointAngle(NodeFeature):
    """Measure the angle of each joint (rad).

    Attributes:
        from_home: Measure it from the standing pose, so that joints which stand bent in different ways share weights.
    """

    kind: ClassVar[str] = "joint"

    from_home: bool = False

    def readings(self, robot: Robot, nodes: tuple[str, ...]) -> list[list[Reading | None]]:
        """Return the readings of the angles, one a node."""
        home = dict(zip((j.name for j in robot.joints), robot.home_angles, strict=True)) if self.from_home else {}
        return [
            [
                Reading(
                    f"angle_{n}_rad",
                    "angle of the joint",
                    "angle",
                    robot.mirror_sign(n),
                    float(home.get(n, 0.0)),
                    "joint encoder",
                )
            ]
            for n in nodes
        ]

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return the angles, shape ``[*, nodes, 1]``."""
        angles = sensed.now.angles - sensed.facts.home if self.from_home else sensed.now.angles
        return np.asarray(angles[..., sensed.facts.node_joints, None])


@dataclass(frozen=True)
class JointVelocity(NodeFeature):
    """Measure the velocity of each joint (rad/s)."""

    kind: ClassVar[str] = "joint"

    def readings(self, robot: Robot, nodes: tuple[str, ...]) -> list[list[Reading | None]]:
        """Return the readings of the velocities, one a node."""
        return [
            [
                Reading(
                    f"velocity_{n}_rad_s",
                    "velocity of the joint",
                    "angular velocity",
                    robot.mirror_sign(n),
                    source="joint encoder",
                )
            ]
            for n in nodes
        ]

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return the velocities, shape ``[*, nodes, 1]``."""
        return sensed.now.velocities[..., sensed.facts.node_joints, None]


@dataclass(frozen=True)
class FootContact(NodeFeature):
    """Detect the contact of each foot with the ground (0 or 1): two numbers a ground node, one for each of its feet."""

    kind: ClassVar[str] = "ground"
    WIDTH: ClassVar[int] = 2

    def readings(self, robot: Robot, nodes: tuple[str, ...]) -> list[list[Reading | None]]:
        """Return the readings of the feet's contacts, two a node; a node of one foot has a number that is always 0."""
        rows: list[list[Reading | None]] = [[None] * self.WIDTH for _ in nodes]
        for foot, (node, place) in zip(robot.feet, foot_slots(robot), strict=True):
            rows[node][place] = Reading(
                f"down_{foot}", "1 if this body touches the ground, else 0", "contact", source="foot contact switch"
            )
        return rows

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return the contacts, shape ``[*, nodes, 2]``."""
        down, (node, place) = sensed.now.feet_down, sensed.facts.foot_slots.T
        numbers = np.zeros((*down.shape[:-1], -int(node.min()), self.WIDTH))
        numbers[..., node, place] = down
        return numbers

    def mirror_places(self, robot: Robot, nodes: tuple[str, ...]) -> np.ndarray:
        """Return the sources that exchange the feet with their mirror images."""
        places = np.stack(np.meshgrid(np.arange(len(nodes)), np.arange(self.WIDTH), indexing="ij"), axis=-1)
        slots = foot_slots(robot)
        slots[:, 0] += len(nodes)
        for foot, other in enumerate(robot.mirror_feet):
            places[tuple(slots[foot])] = slots[other]
        return places


def paper_features() -> dict[str, NodeFeature]:
    """Return the features of the paper (section 2.3), and those of bases without a boom, in their order in a node."""
    return {
        # From standing.
        "height": Height(),
        "velocity": Velocity(),
        # At a node for each other coordinate of a base that no boom holds.
        "base": BaseCoordinate(),
        "base_rate": BaseRate(),
        "angle": JointAngle(),
        "angular_velocity": JointVelocity(),
        "contact": FootContact(),
    }
