"""Node features of a robot that follows a commanded velocity: what an inertial unit, encoders and software know.

Each number stands at the node to which it belongs: what is about pitch at the pitch's base node, the commanded yaw rate
at the yaw's. A robot without such a node, as on a boom, lacks the number.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gctd3.robots.floating_base import EXTRA
from gctd3.robots.robot import Robot
from gctd3.tasks.features import FootContact, Height, JointAngle, JointVelocity, NodeFeature, Reading, Sensed
from gctd3.tasks.heading import coordinate, gravity
from gctd3.tasks.motor_terms import LAST_ACTION
from gctd3.tasks.terms import Remembered
from gctd3.tasks.velocity_command import SWAY, VELOCITY, averaged, velocities

# Names of the command's readings: forward, to the left, turning.
COMMANDS = ("command_forward_m_s", "command_side_m_s", "command_turn_rad_s")
# The same of the velocities that are averaged over the time constant of the reward.
AVERAGED = tuple(
    f"heading_{axis}_over_{SWAY:g}_s_{unit}" for axis, unit in (("forward", "m_s"), ("side", "m_s"), ("turn", "rad_s"))
)
Rows = list[list[Reading | None]]


def _at_base(robot: Robot, readings: dict[str, Reading]) -> Rows:
    """Return the reading of each base node by its coordinate, ``None`` where there is none."""
    return [[readings.get(name)] for name in robot.base.extra]


def _columns(sensed: Sensed, values: dict[str, np.ndarray]) -> np.ndarray:
    """Return the value of each base node by its coordinate, 0 where there is none, shape ``[*, nodes, 1]``."""
    nothing = np.zeros(sensed.now.position.shape)
    return np.stack([values.get(name, nothing) for name in sensed.facts.base], axis=-1)[..., None]


@dataclass(frozen=True)
class GravityUp(NodeFeature):
    """Measure gravity's direction along the body's vertical at the root: -1 for an upright body."""

    kind: ClassVar[str] = "root"

    def readings(self, robot: Robot, nodes: tuple[str, ...]) -> Rows:
        """Return the reading of the component."""
        meaning = "component of gravity's direction along the body's vertical, -1 when the body is upright"
        return [[Reading("gravity_up", meaning, "direction", source="IMU orientation")]]

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return the component, shape ``[*, 1, 1]``."""
        return np.asarray(gravity(sensed.now, sensed.facts)["up"])[..., None, None]


@dataclass(frozen=True)
class GravityDirection(NodeFeature):
    """Measure gravity's direction at the base's nodes: forward at the pitch's, to the left at the roll's."""

    kind: ClassVar[str] = "base"

    def readings(self, robot: Robot, nodes: tuple[str, ...]) -> Rows:
        """Return the readings of the components, one a node."""
        axes = {"pitch": ("forward", "forward axis", 1.0), "roll": ("side", "axis to the left", -1.0)}
        meaning = "component of gravity's direction along the body's {}, 0 when the body is upright"
        readings = {
            node: Reading(f"gravity_{axis}", meaning.format(words), "direction", sign, source="IMU orientation")
            for node, (axis, words, sign) in axes.items()
        }
        return _at_base(robot, readings)

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return the components, shape ``[*, nodes, 1]``."""
        found = gravity(sensed.now, sensed.facts)
        return _columns(sensed, {"pitch": found["forward"], "roll": found["side"]})


@dataclass(frozen=True)
class Gyroscope(NodeFeature):
    """Measure the body's angular rates (rad/s) at the base's nodes."""

    kind: ClassVar[str] = "base"
    AXES: ClassVar[tuple[str, ...]] = ("pitch", "roll", "yaw")

    def readings(self, robot: Robot, nodes: tuple[str, ...]) -> Rows:
        """Return the readings of the rates, one a node."""
        meaning = "{} rate of the root body, as a gyroscope on it measures it"
        rates = {
            axis: Reading(
                f"{axis}_rate_rad_s", meaning.format(axis), "angular velocity", EXTRA[axis], source="IMU gyroscope"
            )
            for axis in self.AXES
        }
        return _at_base(robot, rates)

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return the rates, shape ``[*, nodes, 1]``."""
        now, facts = sensed.now, sensed.facts
        return _columns(sensed, {a: coordinate(now, facts, a, rate=True) for a in self.AXES})


@dataclass(frozen=True)
class LastAction(NodeFeature):
    """Remember the policy's last action at the joint that it moves."""

    kind: ClassVar[str] = "joint"

    def remembers(self) -> tuple[Remembered, ...]:
        """Return the array of the last action."""
        return (LAST_ACTION,)

    def readings(self, robot: Robot, nodes: tuple[str, ...]) -> Rows:
        """Return the readings of the actions, one a node; a joint that no servo drives has none."""
        signs = dict(zip(robot.actuated, robot.action_mirror[1], strict=True))
        meaning = "the policy's last action for this joint, in [-1, 1]; 0 at the start"
        return [
            [Reading(f"action_{n}", meaning, "action", float(signs[n]), source="last action") if n in signs else None]
            for n in nodes
        ]

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return the last action, shape ``[*, nodes, 1]``."""
        facts = sensed.facts
        by_joint = np.zeros((*sensed.now.position.shape, facts.joints))
        by_joint[..., facts.servos.joints] = sensed.memory[LAST_ACTION.name]
        return by_joint[..., facts.node_joints, None]


@dataclass(frozen=True)
class CommandForward(NodeFeature):
    """Sense the commanded velocity forward (m/s) at the root."""

    kind: ClassVar[str] = "root"

    def readings(self, robot: Robot, nodes: tuple[str, ...]) -> Rows:
        """Return the reading of the command."""
        return [[Reading(COMMANDS[0], "commanded velocity along the body's heading", "command", source="command")]]

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return the command, shape ``[*, 1, 1]``."""
        return sensed.memory[VELOCITY][..., None, :1]


@dataclass(frozen=True)
class CommandBase(NodeFeature):
    """Sense the commanded velocity to the left (m/s) at the node ``side``, and the yaw rate (rad/s) at ``yaw``."""

    kind: ClassVar[str] = "base"

    def readings(self, robot: Robot, nodes: tuple[str, ...]) -> Rows:
        """Return the readings of the command, one a node."""
        meanings = {
            "side": (COMMANDS[1], "commanded velocity to the left of the heading"),
            "yaw": (COMMANDS[2], "commanded yaw rate, to the left is positive"),
        }
        readings = {
            node: Reading(name, meaning, "command", -1.0, source="command")
            for node, (name, meaning) in meanings.items()
        }
        return _at_base(robot, readings)

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return the command, shape ``[*, nodes, 1]``."""
        command = sensed.memory[VELOCITY]
        return _columns(sensed, {"side": command[..., 1], "yaw": command[..., 2]})


@dataclass(frozen=True)
class HeadingForward(NodeFeature):
    """Measure the body's velocity along its heading (m/s) at the root, which few robots can.

    Attributes:
        time: Time constant over which it is averaged, as the reward does (s); 0 for none.
    """

    kind: ClassVar[str] = "root"

    time: float = 0.0

    def remembers(self) -> tuple[Remembered, ...]:
        """Return the array of the averaged velocities."""
        return (averaged(self.time),) if self.time else ()

    def readings(self, robot: Robot, nodes: tuple[str, ...]) -> Rows:
        """Return the reading of the velocity."""
        meaning = f"velocity of the root body along its heading{_over(self.time)}"
        name = f"heading_forward{_named(self.time)}_m_s"
        return [[Reading(name, meaning, "velocity", source="state estimator")]]

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return the velocity, shape ``[*, 1, 1]``."""
        return _moved(sensed, self.time)[..., None, :1]


@dataclass(frozen=True)
class HeadingBase(NodeFeature):
    """Measure the velocity to the left of the heading (m/s) at the node ``side``, and the averaged yaw rate at ``yaw``.

    Attributes:
        time: Time constant over which they are averaged, as the reward does (s); 0 for none, and no yaw rate.
    """

    kind: ClassVar[str] = "base"

    time: float = 0.0

    def remembers(self) -> tuple[Remembered, ...]:
        """Return the array of the averaged velocities."""
        return (averaged(self.time),) if self.time else ()

    def readings(self, robot: Robot, nodes: tuple[str, ...]) -> Rows:
        """Return the readings of the velocities, one a node."""
        name, over = _named(self.time), _over(self.time)
        side = f"velocity of the root body to the left of its heading{over}"
        readings = {
            "side": Reading(f"heading_side{name}_m_s", side, "velocity", EXTRA["side"], source="state estimator")
        }
        if self.time:
            yaw, rate = f"yaw rate of the root body{over}", f"heading_turn{name}_rad_s"
            readings["yaw"] = Reading(rate, yaw, "angular velocity", EXTRA["yaw"], source="IMU gyroscope")
        return _at_base(robot, readings)

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return the velocities, shape ``[*, nodes, 1]``."""
        moved = _moved(sensed, self.time)
        return _columns(sensed, {"side": moved[..., 1], **({"yaw": moved[..., 2]} if self.time else {})})


def _named(time: float) -> str:
    return f"_over_{time:g}_s" if time else ""


def _over(time: float) -> str:
    return f", averaged with a time constant of {time:g} s" if time else ""


def _moved(sensed: Sensed, time: float) -> np.ndarray:
    return sensed.memory[averaged(time).name] if time else np.asarray(velocities(sensed.now, sensed.facts))


def velocity_features() -> dict[str, NodeFeature]:
    """Return the features that the policy observes, for which robots have sensors, in their order in a node."""
    return {
        "gravity_up": GravityUp(),
        "gravity": GravityDirection(),
        "gyroscope": Gyroscope(),
        "command_forward": CommandForward(),
        "command_base": CommandBase(),
        # Joints that stand bent in different ways share the network's weights.
        "angle": JointAngle(from_home=True),
        "angular_velocity": JointVelocity(),
        "last_action": LastAction(),
        "contact": FootContact(),
    }


def privileged_features() -> dict[str, NodeFeature]:
    """Return the features that only critics observe: what robots have no sensor for."""
    return {
        "height": Height(),
        "forward": HeadingForward(),
        "side": HeadingBase(),
        # As the reward averages them.
        "forward_averaged": HeadingForward(time=SWAY),
        "base_averaged": HeadingBase(time=SWAY),
    }
