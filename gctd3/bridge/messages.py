"""Messages of the nodes as plain values, which each middleware packs into its own types. Light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

# ``joints``: sensor_msgs/JointState, a :class:`JointSample`. ``switch``: std_msgs/Bool, a bool. ``number``:
# std_msgs/Float64, a float. ``contacts``: gazebo_msgs/ContactsState, a bool. ``clock``: rosgraph_msgs/Clock, whole
# nanoseconds. ``twist``: geometry_msgs/Twist, a :class:`Velocity`. ``text``: std_msgs/String, a str.
Kind = Literal["joints", "switch", "number", "contacts", "clock", "twist", "text"]
TYPES: dict[Kind, str] = {
    "joints": "sensor_msgs/JointState",
    "switch": "std_msgs/Bool",
    "number": "std_msgs/Float64",
    "contacts": "gazebo_msgs/ContactsState",
    "clock": "rosgraph_msgs/Clock",
    "twist": "geometry_msgs/Twist",
    "text": "std_msgs/String",
}
NANO = 1_000_000_000  # nanoseconds in a second


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
class Velocity:
    """Hold a commanded velocity: forward and to the left (m/s), and the yaw rate to the left (rad/s)."""

    forward: float
    side: float
    turn: float


class MessageError(Exception):
    """Report that a message does not have the form on which the nodes have agreed."""
