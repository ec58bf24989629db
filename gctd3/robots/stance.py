"""How a robot stands in a pose: which ends of its legs reach the ground, how high it is, and what else touches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from gctd3.robots.clearance import clearance, placed
from gctd3.robots.ground import can_collide, geoms_of
from gctd3.robots.mjcf import bodies_below

_TOUCHING = 0.05  # of the robot's height: how far above the lowest foot another one still stands
UPRIGHT = np.cos(np.deg2rad(30.0))
_ALIKE = 0.25  # how far the lengths of two legs may differ


@dataclass(frozen=True)
class Stance:
    """Describe how a robot stands in a pose.

    Attributes:
        feet: Indices of the bodies that touch the ground once the robot is lowered onto it.
        lift: How far the pose holds its lowest foot above the ground (m).
        height: Height of the robot (m).
        upright: Whether its root is.
    """

    feet: tuple[int, ...]
    lift: float
    height: float
    upright: bool


def leg_ends(model: mujoco.MjModel, root: int, floor: int) -> list[int]:
    """Return the indices of the bodies at the ends of chains of joints that can touch the floor."""
    touching = [
        b
        for b in bodies_below(model, root)
        if int(model.body_weldid[b]) != int(model.body_weldid[root])
        and any(can_collide(model, g, floor) for g in geoms_of(model, b))
    ]
    inner = {above for body in touching for above in _ancestors(model, body)}
    # What is fixed to a link, as parts of URDFs are, is no farther from the root than the link.
    links = {above for body in touching for above in _ancestors(model, int(model.body_weldid[body]))}
    return [body for body in touching if body not in inner and int(model.body_weldid[body]) not in links]


def _ancestors(model: mujoco.MjModel, body: int) -> list[int]:
    """Return the indices of the bodies between a body and the world."""
    bodies = list[int]()
    while body := int(model.body_parentid[body]):
        bodies.append(body)
    return bodies


def stance(model: mujoco.MjModel, root: int, floor: int, qpos: np.ndarray, ends: Sequence[int]) -> Stance:
    """Return how the robot stands in a pose on those ends of its chains that reach the ground.

    Args:
        model: The model.
        root: Index of the robot's root body.
        floor: Index of the geom that it stands on.
        qpos: The pose, shape ``[nq]``.
        ends: Indices of the bodies that may be feet.
    """
    data = placed(model, qpos)
    lifts = np.array([clearance(model, data, body, floor) for body in ends])
    lowest = float(lifts.min())
    height = float(data.xpos[bodies_below(model, root), 2].max() - data.geom_xpos[floor, 2]) - lowest
    feet = [body for body, lift in zip(ends, lifts, strict=True) if lift <= lowest + _TOUCHING * max(height, 0.0)]
    reference = placed(model, model.qpos0)
    turned = data.xmat[root].reshape(3, 3) @ reference.xmat[root].reshape(3, 3).T
    return Stance(tuple(feet), lowest, height, bool(turned[2, 2] > UPRIGHT))


def like_legs(model: mujoco.MjModel, root: int, ends: Sequence[int], feet: Sequence[int]) -> list[int]:
    """Return the ``ends`` whose chains are built like that of one of the ``feet``: axes alike, links as long."""
    data = placed(model, model.qpos0)
    shapes = {body: _chain_shape(model, data, root, body) for body in ends}

    def alike(a: int, b: int) -> bool:
        (axes, length), (others, far) = shapes[a], shapes[b]
        if len(axes) != len(others) or abs(length - far) > _ALIKE * max(length, far):
            return False
        return all(abs(float(x @ y)) > 0.8 for x, y in zip(np.abs(axes), np.abs(others), strict=True))

    return [body for body in ends if any(alike(body, foot) for foot in feet)]


def _chain_shape(model: mujoco.MjModel, data: mujoco.MjData, root: int, body: int) -> tuple[list[np.ndarray], float]:
    axes, length = list[np.ndarray](), 0.0
    while body not in (root, 0):
        start = int(model.body_jntadr[body])
        axes += [data.xaxis[j].copy() for j in range(start, start + int(model.body_jntnum[body]))] if start >= 0 else []
        length += float(np.linalg.norm(model.body_pos[body])) if int(model.body_parentid[body]) != root else 0.0
        body = int(model.body_parentid[body])
    return axes, length


def lowest_part(model: mujoco.MjModel, root: int, floor: int, qpos: np.ndarray, feet: Sequence[int]) -> int | None:
    """Return the index of a body of the robot that touches the ground although it is no foot and carries none."""
    data = placed(model, qpos)
    ground = min(clearance(model, data, body, floor) for body in feet)
    spared = {*feet, *(int(model.body_parentid[foot]) for foot in feet)} - {root}
    for body in bodies_below(model, root):
        if body not in spared and clearance(model, data, body, floor) < ground + 0.002:
            return body
    return None


def below_feet(
    model: mujoco.MjModel, root: int, floor: int, qpos: np.ndarray, feet: Sequence[int]
) -> tuple[int, float] | None:
    """Return the lowest body of the robot, and by how much (m), if it ends clearly below all of the feet.

    Bodies between the root and a foot do not count, nor does what is fixed to a foot.
    """
    data, weld = placed(model, qpos), model.body_weldid
    fixed = {int(weld[foot]) for foot in feet}
    others = {body for body in bodies_below(model, root) if int(weld[body]) not in fixed}
    others -= {body for foot in feet for body in _ancestors(model, foot)} - {root}
    lifts = {body: clearance(model, data, body, floor) for body in others}
    if not lifts:
        return None
    lowest = min(lifts, key=lambda body: lifts[body])
    depth = min(clearance(model, data, foot, floor) for foot in feet) - lifts[lowest]
    tall = float(data.xpos[bodies_below(model, root), 2].max() - data.geom_xpos[floor, 2]) - lifts[lowest]
    return (lowest, depth) if depth > _TOUCHING * tall else None
