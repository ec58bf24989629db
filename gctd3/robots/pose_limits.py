"""Corrections of a pose: joints into their ranges, the robot down or up to the ground."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from gctd3.robots.actuators import is_position_servo
from gctd3.robots.clearance import placed
from gctd3.robots.mjcf import base_joints


def lowered(model: mujoco.MjModel, root: int, qpos: np.ndarray, lift: float) -> np.ndarray:
    """Return a pose moved down by ``lift`` (m); as it is if the root has no joint along z."""
    moved = qpos.copy()
    for joint in base_joints(model, root):
        start, kind = int(model.jnt_qposadr[joint]), int(model.jnt_type[joint])
        if kind == int(mujoco.mjtJoint.mjJNT_FREE):
            moved[start + 2] -= lift
            break
        axis = placed(model, qpos).xaxis[joint]
        if kind == int(mujoco.mjtJoint.mjJNT_SLIDE) and abs(axis[2]) > 0.999:
            moved[start] -= lift * np.sign(axis[2])
            break
    return moved


def clipped(model: mujoco.MjModel, qpos: np.ndarray, joints: Sequence[int]) -> tuple[np.ndarray, list[int]]:
    """Return a pose with the given joints in their ranges and those of their servos, and which of them were outside."""
    moved, outside = qpos.copy(), list[int]()
    servos = {int(model.actuator_trnid[i, 0]): i for i in range(model.nu) if is_position_servo(model, i)}
    for joint in joints:
        if int(model.jnt_type[joint]) not in (2, 3):
            continue
        start = int(model.jnt_qposadr[joint])
        place = float(qpos[start])
        if model.jnt_limited[joint]:
            place = float(np.clip(place, *model.jnt_range[joint]))
        servo = servos.get(joint)
        if servo is not None and model.actuator_ctrllimited[servo] and float(model.actuator_gear[servo, 0]) == 1.0:
            place = float(np.clip(place, *model.actuator_ctrlrange[servo]))
        if abs(place - qpos[start]) > 1e-4:
            outside.append(joint)
            moved[start] = place
    return moved, outside
