"""Heights of a robot's soles from its joint angles and the vertical, without a simulator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from gctd3.robots.array_library import array_namespace
from gctd3.robots.geometry import geom_points
from gctd3.robots.mjcf import colliding_geoms, joint_kind, joint_name
from gctd3.robots.robot import Robot

Array = Any  # of NumPy or of PyTorch


@dataclass(frozen=True)
class _Joint:
    """Describe a joint of a leg in the standing pose, in the base's frame (forward, left, up).

    Attributes:
        index: Index among ``robot.joints``.
        slides: Whether it slides along its axis; else it turns about it.
        axis: Its axis, shape ``[3]``.
        offset: Its place from the joint before, or from the root body, shape ``[3]`` (m).
        home: Its angle in the standing pose (rad; m of a slide).
    """

    index: int
    slides: bool
    axis: np.ndarray
    offset: np.ndarray
    home: float


@dataclass(frozen=True)
class SoleHeights:
    """Compute how high each foot's lowest point is above the root body.

    The vertical, as it lies in the frame of the root body, is carried along each leg from joint to joint (Rodrigues'
    rotation), and what it has of each offset is added up.

    Attributes:
        legs: Joints from the root to each foot.
        points: Points of each foot whose hull is the foot's, from its last joint, shape ``[K, 3]`` each (m).
        standing: Height of the root body above the lowest foot in the standing pose (m).
    """

    legs: tuple[tuple[_Joint, ...], ...]
    points: tuple[np.ndarray, ...]
    standing: float

    @classmethod
    def of(cls, robot: Robot) -> SoleHeights | None:
        """Read the legs of a robot; ``None`` if a leg has a joint whose angle is not measured."""
        model, data, frame = robot.model, mujoco.MjData(robot.model), robot.base.frame
        data.qpos[:] = robot.standing_qpos
        mujoco.mj_kinematics(model, data)
        known = {joint.name: i for i, joint in enumerate(robot.joints)}
        legs, clouds, root = [], [], robot.base.root
        for foot in robot.foot_bodies:
            bodies, body = list[int](), foot
            while body != root:
                bodies.append(body)
                body = int(model.body_parentid[body])
            place, leg = data.xpos[root], list[_Joint]()
            for body in reversed(bodies):
                for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
                    name, kind = joint_name(model, joint), joint_kind(model, joint)
                    if name not in known or kind not in ("hinge", "slide"):
                        return None
                    home = float(data.qpos[model.jnt_qposadr[joint]])
                    offset = frame @ (data.xanchor[joint] - place)
                    leg.append(_Joint(known[name], kind == "slide", frame @ data.xaxis[joint], offset, home))
                    place = data.xanchor[joint]
            found = [geom_points(model, data, geom) for geom in colliding_geoms(model, foot)]
            cloud = np.concatenate(found) if found else data.xpos[[foot]]
            legs.append(tuple(leg))
            clouds.append((cloud - place) @ frame.T)
        soles = cls(tuple(legs), tuple(clouds), 0.0)
        pose = np.array([data.qpos[joint.qpos] for joint in robot.joints])
        lowest = soles.below(pose, np.array([0.0, 0.0, 1.0])).min()
        return cls(soles.legs, soles.points, -float(lowest))

    def below(self, angles: Array, up: Array) -> Array:
        """Return the height of each foot's lowest point from the root body's origin, shape ``[*, feet]`` (m).

        Args:
            angles: Angles of ``robot.joints``, shape ``[*, J]`` (rad).
            up: The vertical in the frame of the root body, forward, left and up when it stands, shape ``[*, 3]``.
        """
        xp = array_namespace(angles)
        heights = []
        for leg, points in zip(self.legs, self.points, strict=True):
            height: Array = xp.zeros_like(angles[..., 0])
            carried = up
            for joint in leg:
                offset, axis = (xp.asarray(values, dtype=angles.dtype) for values in (joint.offset, joint.axis))
                height = height + xp.sum(carried * offset, axis=-1)
                along, moved = xp.sum(carried * axis, axis=-1), angles[..., joint.index] - joint.home
                if joint.slides:
                    height = height + along * moved
                else:
                    carried = _turned(xp, carried, axis, along, -moved)
            cloud = xp.asarray(points, dtype=angles.dtype)
            heights.append(height + xp.min(carried @ cloud.T, axis=-1))
        return xp.stack(heights, axis=-1)


def _turned(xp: Any, vector: Array, axis: Array, along: Array, angle: Array) -> Array:  # noqa: ANN401 - a module
    """Turn vectors ``[*, 3]`` about a unit axis ``[3]`` by angles ``[*]`` (rad); ``along`` is their part along it."""
    x, y, z = (vector[..., i] for i in range(3))
    crossed = xp.stack([axis[1] * z - axis[2] * y, axis[2] * x - axis[0] * z, axis[0] * y - axis[1] * x], axis=-1)
    cos, sin = xp.cos(angle)[..., None], xp.sin(angle)[..., None]
    return vector * cos + crossed * sin + axis * (along[..., None] * (1.0 - cos))
