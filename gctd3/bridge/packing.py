"""Messages of ROS 1 and ROS 2 from plain values, and back: their fields have the same names. Light."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from gctd3.bridge.messages import ImuSample, JointSample, Kind, Velocity

IMU = {"orientation": "xyzw", "angular_velocity": "xyz", "linear_acceleration": "xyz"}  # fields of a sensor_msgs/Imu
MISSING = -1.0  # first covariance of what a sensor_msgs/Imu does not hold


def fill(message: Any, kind: Kind, value: Any, stamp: Callable[[int], Any], contact: Callable[[], Any]) -> Any:  # noqa: ANN401
    """Fill an empty message with a plain value, and return it.

    Args:
        message: The message, of the middleware's type.
        kind: Its kind, which says what the value is, see :data:`.Kind`.
        value: The value.
        stamp: Function that makes the middleware's time from nanoseconds.
        contact: Function that makes an empty gazebo_msgs/ContactState.
    """
    if kind == "joints":
        message.header.stamp, message.header.frame_id = stamp(value.stamp), value.frame
        message.name, message.position = list(value.names), list(value.positions)
        message.velocity = list(value.velocities)
    elif kind == "imu":
        message.header.stamp, message.header.frame_id = stamp(value.stamp), value.frame
        for name, axes in IMU.items():
            given = getattr(value, name)
            if given is not None:
                for axis, number in zip(axes, given, strict=True):
                    setattr(getattr(message, name), axis, number)
            # A covariance of 0 stands for one that is not known.
            setattr(message, f"{name}_covariance", [MISSING if given is None else 0.0, *[0.0] * 8])
    elif kind == "contacts":
        message.header.stamp, message.states = stamp(time.time_ns()), [contact()] if value else []
    elif kind == "clock":
        message.clock = stamp(value)
    elif kind == "twist":
        message.linear.x, message.linear.y, message.angular.z = value.forward, value.side, value.turn
    else:
        message.data = value
    return message


def plain(kind: Kind, message: Any, nanoseconds: Callable[[Any], int]) -> Any:  # noqa: ANN401
    """Return the plain value of a message, see :data:`.Kind`.

    Args:
        kind: Kind of the message.
        message: The message.
        nanoseconds: Function that reads the middleware's time.
    """
    if kind == "joints":
        header = message.header
        lists = (tuple(values) for values in (message.name, message.position, message.velocity))
        return JointSample(nanoseconds(header.stamp), header.frame_id, *lists)
    if kind == "imu":
        parts: dict[str, Any] = {}
        for name, axes in IMU.items():
            missing = getattr(message, f"{name}_covariance")[0] == MISSING
            parts[name] = None if missing else tuple(float(getattr(getattr(message, name), axis)) for axis in axes)
        return ImuSample(nanoseconds(message.header.stamp), message.header.frame_id, **parts)
    if kind == "contacts":
        return bool(message.states)
    if kind == "clock":
        return nanoseconds(message.clock)
    if kind == "twist":
        return Velocity(message.linear.x, message.linear.y, message.angular.z)
    return message.data
