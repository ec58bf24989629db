"""The feet of a robot: the bodies named, or else those that stand on the ground."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from gctd3.errors import RobotError, suggest
from gctd3.robots.geometry import lowest_point
from gctd3.robots.mjcf import bodies_below, body_name, colliding_geoms, leaf_bodies, standing_pose

_TOUCHING = 0.05  # of the robot's height: how far above the lowest foot another one still stands


def named_feet(model: mujoco.MjModel, root: int, names: str | Sequence[str], file: Path) -> list[str]:
    """Find the bodies with the given names, or with geoms of these names; ``names`` may be a single one.

    Raises:
        RobotError: If there is neither such a body nor such a geom, or none is named.
    """
    bodies = {body_name(model, b): b for b in bodies_below(model, root)}
    geoms = {model.geom(g).name: int(model.geom_bodyid[g]) for g in range(model.ngeom) if model.geom(g).name}
    feet = []
    for name in [names] if isinstance(names, str) else names:
        body = bodies.get(name, geoms.get(name))
        if body is None or body not in bodies.values():
            raise RobotError(f"{file} has no body {name!r}.{suggest(name, bodies)} Its bodies are {', '.join(bodies)}.")
        feet.append(body_name(model, body))
    if not feet:
        raise RobotError(f"{file}: feet must name at least one body, got none.")
    return list(dict.fromkeys(feet))


def find_feet(model: mujoco.MjModel, root: int, file: Path) -> list[str]:
    """Find the feet of a robot for which none are named.

    The robot is lowered onto the ground in its standing pose (:func:`.standing_pose`) until the first body at the end
    of a chain touches; that one and every other whose lowest point is then within 5 % of the robot's height of the
    ground are its feet. Legs that hang at other heights have to be named.

    Raises:
        RobotError: If no chain ends in a body with a geom that collides.
    """
    leaves = leaf_bodies(model, root)
    if not leaves:
        raise RobotError(f"{file} has no foot: no leg ends in a body with a geom that collides.")
    data = mujoco.MjData(model)
    data.qpos[:] = standing_pose(model)
    mujoco.mj_kinematics(model, data)
    lowest = np.array([lowest_point(model, data, colliding_geoms(model, body)) for body in leaves])
    height = float(data.xpos[bodies_below(model, root), 2].max()) - float(lowest.min())
    touching = lowest <= lowest.min() + _TOUCHING * max(height, 0.0)
    return [body_name(model, body) for body, touches in zip(leaves, touching, strict=True) if touches]


def foot_place(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> np.ndarray:
    """Return the mean place of the colliding geoms of a foot, or the body's own, shape ``[3]`` (m, in the world)."""
    geoms = colliding_geoms(model, body)
    return np.asarray(data.geom_xpos[geoms].mean(axis=0) if geoms else data.xpos[body])
