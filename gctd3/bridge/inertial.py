"""Inertial readings of a policy in ``sensor_msgs/Imu``, by the conventions of REP 103 and REP 145. Light.

The message's axes are the body's: x forward, y to the left, z up. The orientation turns them into the world's, z up and
x forward where yaw is 0; angular velocity and linear acceleration are along the body's. The latter is the specific
force: a robot at rest measures 9.81 m/s^2 upwards.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from gctd3.bridge.messages import ImuSample, MessageError, Quaternion, Topic, Vector
from gctd3.deploy.contract import Contract

ROLL, PITCH, YAW = range(3)
NORM = 1e-3  # by which a quaternion's norm may differ from 1, as of one in few digits; drivers without one send zeros

# The third row of the rotation matrix of a unit quaternion (x, y, z, w) is the world's vertical in the body's axes, and
# gravity's direction is its opposite. Roll and pitch are those of a body turned by yaw, then pitch, then roll.
ORIENTATION: dict[str, Callable[[Vector], float]] = {
    "gravity_forward": lambda up: -up[0],
    "gravity_side": lambda up: -up[1],
    "gravity_up": lambda up: -up[2],
    "roll_rad": lambda up: math.atan2(up[1], up[2]),
    "pitch_rad": lambda up: math.asin(min(max(-up[0], -1.0), 1.0)),
}
RATES = {"roll_rate_rad_s": ROLL, "pitch_rate_rad_s": PITCH, "yaw_rate_rad_s": YAW}
# By the source that the contract states.
READINGS = {"IMU orientation": tuple(ORIENTATION), "IMU gyroscope": tuple(RATES)}


def inertial_readings(contract: Contract) -> tuple[str, ...]:
    """Return the names of the contract's readings that a ``sensor_msgs/Imu`` holds."""
    features = contract.features
    return tuple(str(one.reading) for one in features if one.reading in READINGS.get(one.source, ()))


def orientation_of(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Compute the unit quaternion (x, y, z, w) of a body that is turned by yaw, then pitch, then roll (rad)."""
    (sr, cr), (sp, cp), (sy, cy) = ((math.sin(angle / 2), math.cos(angle / 2)) for angle in (roll, pitch, yaw))
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def vertical(orientation: Quaternion) -> Vector:
    """Compute the world's vertical in the axes of a body with a unit quaternion (x, y, z, w)."""
    x, y, z, w = orientation
    return 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


def unpack_inertial(topic: Topic, sample: ImuSample, names: tuple[str, ...]) -> dict[str, float]:
    """Return readings in a message by their names.

    Args:
        topic: Topic of the message, for errors.
        sample: The message.
        names: Names of the readings, some of :func:`inertial_readings`.

    Raises:
        MessageError: If the message lacks what a reading needs, or its quaternion is not one of a rotation.
    """
    found = {}
    if turned := [name for name in names if name in ORIENTATION]:
        if sample.orientation is None:
            raise MessageError(
                f"{topic.name} has no orientation (orientation_covariance[0] is -1), from which this policy reads "
                f"{', '.join(turned)}."
            )
        norm = math.hypot(*sample.orientation)
        if not abs(norm - 1) <= NORM:
            raise MessageError(f"{topic.name} has an orientation of norm {norm:.4g}, expected a unit quaternion.")
        x, y, z, w = (part / norm for part in sample.orientation)
        up = vertical((x, y, z, w))
        found = {name: ORIENTATION[name](up) for name in turned}
    if rates := [name for name in names if name in RATES]:
        if sample.angular_velocity is None:
            raise MessageError(
                f"{topic.name} has no angular velocity (angular_velocity_covariance[0] is -1), from which this policy "
                f"reads {', '.join(rates)}."
            )
        found |= {name: sample.angular_velocity[RATES[name]] for name in rates}
    return found
