"""The legs of a robot: the joints down to each foot, the hip that swings it, and their length."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from gctd3.robots.feet import foot_place
from gctd3.robots.geometry import lowest_point
from gctd3.robots.mjcf import Joint, colliding_geoms

_LATERAL = 0.7  # least component across the body of the axis of a hip that swings the leg forwards


def find_legs(model: mujoco.MjModel, joints: Sequence[Joint], feet: Sequence[int]) -> tuple[tuple[Joint, ...], ...]:
    """Find for each foot the joints from the root down to it.

    Args:
        model: The model.
        joints: The robot's joints.
        feet: Indices of the feet's bodies.
    """
    by_name, legs = {joint.name: joint for joint in joints}, []
    for foot in feet:
        chain: list[Joint] = []
        last = _joints_above(model, joints, foot)
        name: str | None = last[-1].name if last else None
        while name is not None:
            chain.append(by_name[name])
            name = chain[-1].parent
        legs.append(tuple(reversed(chain)))
    return tuple(legs)


def find_hips(
    model: mujoco.MjModel, qpos: np.ndarray, frame: np.ndarray, legs: Sequence[Sequence[Joint]], feet: Sequence[int]
) -> tuple[Joint, ...]:
    """Find for each foot the hip: the first joint of its own leg that swings the foot forwards and backwards.

    A joint swings the foot forwards if that is the largest part of the foot's motion, as the robot stands: neither
    abduction nor yaw does so, nor does a waist, which other legs share. A leg without such a joint has its first own
    joint for a hip.

    Args:
        model: The model.
        qpos: The standing pose, shape ``[nq]``.
        frame: Unit vectors of the base, forward, lateral and up, as rows, shape ``[3, 3]``.
        legs: The joints of each leg, from the root down.
        feet: Indices of the feet's bodies.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    hips = []
    for i, (foot, leg) in enumerate(zip(feet, legs, strict=True)):
        shared = {joint.name for k, other in enumerate(legs) if k != i for joint in other}
        own = [joint for joint in leg if joint.name not in shared] or list(leg)
        place = foot_place(model, data, foot)
        swinging = (joint for joint in own if _swings(data, frame, joint, place))
        hips.append(next(swinging, own[0]) if own else None)
    return tuple(hip for hip in hips if hip is not None)


def measure_leg_length(model: mujoco.MjModel, qpos: np.ndarray, hips: Sequence[Joint], feet: Sequence[int]) -> float:
    """Measure the height of the hips above the lowest point of the feet in a pose ``[nq]``, the mean over legs (m)."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    geoms = [geom for foot in feet for geom in colliding_geoms(model, foot)]
    return float(np.mean([data.xanchor[hip.id][2] for hip in hips]) - lowest_point(model, data, geoms))


def _joints_above(model: mujoco.MjModel, joints: Sequence[Joint], body: int) -> list[Joint]:
    """Return the joints of a body, or of the nearest body above it that has some."""
    while body:
        moving = [joint for joint in joints if int(model.jnt_bodyid[joint.id]) == body]
        if moving:
            return moving
        body = int(model.body_parentid[body])
    return []


def _swings(data: mujoco.MjData, frame: np.ndarray, joint: Joint, place: np.ndarray) -> bool:
    """Tell whether a joint moves a foot at ``place`` (m) forwards and backwards."""
    axis = data.xaxis[joint.id]
    motion = np.cross(axis, place - data.xanchor[joint.id]) if joint.kind == "hinge" else axis
    along = np.abs(frame @ motion)
    # Of an axis across the body the foot moves in the sagittal plane, and under the hip mostly forwards.
    lateral = joint.kind != "hinge" or abs(float(frame[1] @ axis)) > _LATERAL
    return bool(lateral and along[0] > along[1])
