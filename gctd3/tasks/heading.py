"""Motion of the body as a command names it: forward, to the left and turning, and the direction of gravity.

Velocities are those of the root body in the frame that is turned by the body's yaw only (its heading), as a person who
steers the robot names them; angular rates are those of a gyroscope on the body.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from gctd3.robots.array_library import array_namespace
from gctd3.tasks.measurement import Measurement

if TYPE_CHECKING:
    from gctd3.tasks.terms import RobotFacts

Array = Any  # of NumPy or of PyTorch
AXES = ("forward", "side", "turn")  # of a commanded velocity (m/s, m/s, rad/s)


def coordinate(now: Measurement, facts: RobotFacts, name: str, rate: bool = False) -> Array:
    """Return a coordinate of the base or its rate, 0 for a base without it, shape ``[*]`` (rad, m, and per second)."""
    if name not in facts.base:
        return now.velocity * 0.0
    return now.base[..., facts.base.index(name), int(rate)]


def heading_velocity(now: Measurement, facts: RobotFacts) -> tuple[Array, Array]:
    """Return the body's velocity along its heading and to the left of it, each of shape ``[*]`` (m/s)."""
    xp = array_namespace(now.velocity)
    yaw, side = coordinate(now, facts, "yaw"), coordinate(now, facts, "side", rate=True)
    cos, sin = xp.cos(yaw), xp.sin(yaw)
    return cos * now.velocity + sin * side, cos * side - sin * now.velocity


def yaw_rate(now: Measurement, facts: RobotFacts) -> Array:
    """Return the angular rate about the body's vertical axis, to the left is positive, shape ``[*]`` (rad/s)."""
    return coordinate(now, facts, "yaw", rate=True)


def gravity(now: Measurement, facts: RobotFacts) -> dict[str, Array]:
    """Return the direction of gravity in the body's frame by axis: ``forward``, ``side`` and ``up``, each ``[*]``.

    Angles are those of :meth:`.Base.read`: the body is turned by yaw, then pitch, then roll, so that the world's
    vertical is ``(-sin(pitch), cos(pitch) sin(roll), cos(pitch) cos(roll))`` in its frame.
    """
    xp = array_namespace(now.velocity)
    pitch, roll = coordinate(now, facts, "pitch"), coordinate(now, facts, "roll")
    return {
        "forward": xp.sin(pitch),
        "side": -xp.cos(pitch) * xp.sin(roll),
        "up": -xp.cos(pitch) * xp.cos(roll),
    }
