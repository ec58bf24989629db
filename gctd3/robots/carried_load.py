"""The load of a standing robot: what its joints carry, and what its servos are asked for so that they carry it."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from gctd3.robots.clearance import placed, sole
from gctd3.robots.mjcf import base_joints, driven_joints

STANDS = 5e-3  # thickness of the sole on which a foot stands, which may be tilted a little (m)


def carried_load(model: mujoco.MjModel, qpos: np.ndarray, feet: Sequence[int], floor: int) -> np.ndarray:
    """Return the generalised force with which each degree of freedom carries the standing robot, shape ``[nv]``.

    The ground pushes straight up on the feet, by forces that hold the base and whose squares are least in sum.
    """
    data = placed(model, qpos)
    mujoco.mj_forward(model, data)
    columns = []
    for body in feet:
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, jacobian, None, sole(model, data, body, floor, STANDS), body)
        columns.append(jacobian[2])
    pushes, weight = np.array(columns), data.qfrc_bias.copy()
    root = int(model.body_rootid[feet[0]])
    base = [
        d
        for j in base_joints(model, root)
        for d in range(model.jnt_dofadr[j], model.jnt_dofadr[j] + {0: 6, 1: 3}.get(int(model.jnt_type[j]), 1))
    ]
    forces = np.linalg.lstsq(pushes[:, base].T, weight[base], rcond=None)[0] if base else np.zeros(len(columns))
    return np.asarray(weight - data.qfrc_passive - forces @ pushes)


def carrying_command(model: mujoco.MjModel, qpos: np.ndarray, feet: Sequence[int], floor: int) -> np.ndarray:
    """Return the desired angle of each servo whose error carries the robot's weight in a pose, shape ``[nu]`` (rad)."""
    joints, load = driven_joints(model), carried_load(model, qpos, feet, floor)
    torque = load[[int(model.jnt_dofadr[j]) for j in joints]]
    limited = model.actuator_forcelimited.astype(bool)
    low, high = np.where(limited, model.actuator_forcerange.T, [[-np.inf], [np.inf]])
    home = qpos[[int(model.jnt_qposadr[j]) for j in joints]]
    command = home + np.clip(torque, low, high) / model.actuator_gainprm[:, 0]
    return np.asarray(np.clip(command, *model.actuator_ctrlrange.T))
