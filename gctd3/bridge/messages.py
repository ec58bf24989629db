"""Messages of the nodes as plain values, which each middleware packs into its own types. Light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

# ``joints``: sensor_msgs/JointState, a :class:`JointSample`. ``imu``: sensor_msgs/Imu, an :class:`ImuSample`.
# ``switch``: std_msgs/Bool, a bool. ``number``: std_msgs/Float64, a float. ``contacts``: gazebo_msgs/ContactsState, a
# bool. ``clock``: rosgraph_msgs/Clock, whole nanoseconds. ``twist``: geometry_msgs/Twist, a :class:`Velocity`.
# ``text``: std_msgs/String, a str.
Kind = Literal["joints", "imu", "switch", "number", "contacts", "clock", "twist", "text"]
TYPES: dict[Kind, str] = {
    "joints": "sensor_msgs/JointState",
    "imu": "sensor_msgs/Imu",
    "switch": "std_msgs/Bool",
    "number": "std_msgs/Float64",
    "contacts": "gazebo_msgs/ContactsState",
    "clock": "rosgraph_msgs/Clock",
    "twist": "geometry_msgs/Twist",
    "text": "std_msgs/String",
}
NANO = 1_000_000_000  # nanoseconds in a second
Vector = tuple[float, float, float]  # x, y, z
Quaternion = tuple[float, float, float, float]  # x, y, z, w


@dataclass(frozen=True)
class Topic:
    """Name a topic and the kind of its messages.

    Attributes:
        name: Name, with the leading slash.
        kind: Kind of its messages.
        latched: Whether who subscribes later gets the last message, too.
    """

    name: str
    kind: Kind
    latched: bool = False


@dataclass(frozen=True)
class JointSample:
    """Hold angles of joints at one time.

    Attributes:
        stamp: Time (ns).
        frame: ``frame_id`` of the header.
        names: Names of the joints.
        positions: Angles, one a name (rad; m for a slide).
        velocities: Velocities, one a name, or none (rad/s; m/s).
    """

    stamp: int
    frame: str
    names: tuple[str, ...]
    positions: tuple[float, ...]
    velocities: tuple[float, ...] = ()


@dataclass(frozen=True)
class ImuSample:
    """Hold what an inertial unit measures at one time, in the axes of :mod:`.inertial`; ``None`` for what it does not.

    Attributes:
        stamp: Time (ns).
        frame: ``frame_id`` of the header.
        orientation: Unit quaternion from the body's axes to the world's.
        angular_velocity: Angular velocity along the body's axes (rad/s).
        linear_acceleration: Specific force along the body's axes (m/s^2).
    """

    stamp: int
    frame: str
    orientation: Quaternion | None
    angular_velocity: Vector | None
    linear_acceleration: Vector | None = None


@dataclass(frozen=True)
class Velocity:
    """Hold a commanded velocity: forward and to the left (m/s), and the yaw rate to the left (rad/s)."""

    forward: float
    side: float
    turn: float


class MessageError(Exception):
    """Report that a message does not have the form on which the nodes have agreed."""
