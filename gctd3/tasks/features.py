"""Features of the nodes of a robot's graph: one table, from which everything that depends on them is derived.

The observation, its reflection in the mirror, the exported contract, sensor noise and evaluation read this table. The
paper's task has two features a node (section 2.3): height and forward velocity of the root, angle and velocity of a
joint, the contacts of the feet on the ground. A feature of your own is a class in your package and a line of YAML:
``+task.features.mine._target_=my_package.Mine``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from gctd3.errors import ConfigError
from gctd3.robots.floating_base import EXTRA
from gctd3.robots.graph import KinematicGraph
from gctd3.robots.nodes import foot_slots
from gctd3.robots.robot import Robot
from gctd3.tasks.measurement import Measurement
from gctd3.tasks.terms import RobotFacts

Quantity = Literal["angle", "angular velocity", "length", "velocity", "contact", "command"]
KINDS = ("root", "base", "joint", "ground")  # of nodes


@dataclass(frozen=True)
class Reading:
    """Describe one sensor reading of a node.

    Attributes:
        name: Name with its unit, such as ``angle_hip_right_rad``, for the robot's software.
        meaning: Meaning in words.
        quantity: Measured quantity, which determines the size of the sensor's error.
        sign: +1 if the reading keeps its sign in the mirror, -1 if not.
    """

    name: str
    meaning: str
    quantity: Quantity
    sign: float = 1.0


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
        return [[Reading("height_m", "height of the root body, 0 when the robot stands", "length")]]

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return the height, shape ``[*, 1, 1]``."""
        return sensed.now.height[..., None, None]


@dataclass(frozen=True)
class Velocity(NodeFeature):
    """Measure the body's forward velocity (m/s) at the root."""

    kind: ClassVar[str] = "root"

    def readings(self, robot: Robot, nodes: tuple[str, ...]) -> list[list[Reading | None]]:
        """Return the reading of the velocity."""
        return [[Reading("velocity_m_s", "forward velocity of the root body", "velocity")]]

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
            rows.append([Reading(f"{name}_{unit}", meaning, quantity, EXTRA[name])])
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
            rows.append([Reading(f"{name}_rate_{unit}_s", meaning, quantity, EXTRA[name])])
        return rows

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return the rates, shape ``[*, nodes, 1]``."""
        return sensed.now.base[..., 1:]


@dataclass(frozen=True)
class JointAngle(NodeFeature):
    """Measure the angle of each joint (rad)."""

    kind: ClassVar[str] = "joint"

    def readings(self, robot: Robot, nodes: tuple[str, ...]) -> list[list[Reading | None]]:
        """Return the readings of the angles, one a node."""
        return [[Reading(f"angle_{n}_rad", "angle of the joint", "angle", robot.mirror_sign(n))] for n in nodes]

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return the angles, shape ``[*, nodes, 1]``."""
        return sensed.now.angles[..., sensed.facts.node_joints, None]


@dataclass(frozen=True)
class JointVelocity(NodeFeature):
    """Measure the velocity of each joint (rad/s)."""

    kind: ClassVar[str] = "joint"

    def readings(self, robot: Robot, nodes: tuple[str, ...]) -> list[list[Reading | None]]:
        """Return the readings of the velocities, one a node."""
        return [
            [Reading(f"velocity_{n}_rad_s", "velocity of the joint", "angular velocity", robot.mirror_sign(n))]
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
            rows[node][place] = Reading(f"down_{foot}", "1 if this body touches the ground, else 0", "contact")
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


class FeatureTable:
    """Compose the features of one robot, and assign their numbers to its nodes.

    Numbers of several features of one kind of node follow one another; nodes with fewer numbers are padded with zeros.

    Args:
        features: Features by name, in order.
        robot: The robot.
        graph: The robot's graph, of which only the nodes are used.

    Attributes:
        width: ``F``, features of a node in one frame.
        readings: Readings of each node, a row of ``F``; ``None`` for a number that is always 0.

    Raises:
        ConfigError: If a feature has an unknown kind, does not name as many readings for each of its nodes, or no node
            has a feature.
    """

    def __init__(self, features: Mapping[str, NodeFeature], robot: Robot, graph: KinematicGraph) -> None:
        self.graph, self.robot = graph, robot
        kinds = [kind if kind in KINDS else "joint" for kind in graph.kinds]
        filled = dict.fromkeys(KINDS, 0)
        self._placed: list[tuple[str, NodeFeature, list[int], int, int]] = []
        rows: list[list[Reading | None]] = [[] for _ in kinds]
        for name, feature in features.items():
            if feature.kind not in KINDS:
                raise ConfigError(
                    f"task.features.{name}: there are no nodes of kind {feature.kind!r}; kinds: {', '.join(KINDS)}."
                )
            nodes = [i for i, kind in enumerate(kinds) if kind == feature.kind]
            if not nodes:
                continue
            said = feature.readings(robot, tuple(graph.nodes[i] for i in nodes))
            if len(said) != len(nodes) or len({len(row) for row in said}) != 1:
                raise ConfigError(
                    f"task.features.{name} must say as many readings for each of {len(nodes)} nodes, got {said!r}."
                )
            width, start = len(said[0]), filled[feature.kind]
            filled[feature.kind] += width
            self._placed.append((name, feature, nodes, start, width))
            for node, row in zip(nodes, said, strict=True):
                rows[node] += row
        self.width = max(map(len, rows))
        if not self.width:
            raise ConfigError("task.features must hold at least one feature that a node of the robot has, got none.")
        self.readings = [row + [None] * (self.width - len(row)) for row in rows]

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return the features of every node in one frame (section 2.3), ``float32 [*, N, F]``."""
        numbers = np.zeros((*sensed.now.position.shape, self.graph.num_nodes, self.width), dtype=np.float32)
        for _, feature, nodes, start, width in self._placed:
            # Nodes of a kind follow one another.
            numbers[..., nodes[0] : nodes[-1] + 1, start : start + width] = feature(sensed)
        return numbers

    def check(self, sensed: Sensed) -> None:
        """Raise a :class:`.ConfigError` unless every feature returns finite numbers of the declared shape."""
        for name, feature, nodes, _, width in self._placed:
            try:
                values = np.asarray(feature(sensed))
            except KeyError as error:
                known = ", ".join(sensed.memory)
                raise ConfigError(
                    f"task.features.{name} reads {error}, which is not remembered. Remembered: {known}."
                ) from error
            expected = (*sensed.now.position.shape, len(nodes), width)
            if values.shape != expected or not np.isfinite(values).all():
                raise ConfigError(
                    f"task.features.{name} must return finite numbers of shape {list(expected)}, got "
                    f"{list(values.shape)} {values.dtype}."
                )

    def reflection(self) -> tuple[np.ndarray, np.ndarray]:
        """Return source and sign, each ``[N * F]``: ``sign * frame[source]`` is the mirrored robot's frame."""
        graph, width = self.graph, self.width
        source = np.arange(graph.num_nodes * width).reshape(graph.num_nodes, width)[list(graph.mirror)]
        sign = np.ones(source.shape)
        for _, feature, nodes, start, count in self._placed:
            places = feature.mirror_places(self.robot, tuple(graph.nodes[i] for i in nodes))
            if places is not None:
                node, number = np.moveaxis(places, -1, 0)
                source[nodes, start : start + count] = (node + nodes[0]) * width + start + number
        for i, row in enumerate(self.readings):
            for k, reading in enumerate(row):
                sign[i, k] = 1.0 if reading is None else reading.sign
        return source.reshape(-1), sign.reshape(-1)

    def deviations(self, errors: Mapping[str, float]) -> np.ndarray:
        """Return the standard deviation of each number's error in a frame, shape ``[N, F]``.

        Args:
            errors: Standard deviation of each quantity's error; 0 for a quantity that is missing.
        """
        return np.array([[0.0 if r is None else errors.get(r.quantity, 0.0) for r in row] for row in self.readings])


def paper_features() -> dict[str, NodeFeature]:
    """Return the features of the paper (section 2.3), and those of bases without a boom."""
    return {
        "height": Height(),
        "velocity": Velocity(),
        "base": BaseCoordinate(),
        "base_rate": BaseRate(),
        "angle": JointAngle(),
        "angular_velocity": JointVelocity(),
        "contact": FootContact(),
    }
