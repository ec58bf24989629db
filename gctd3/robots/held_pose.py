"""A simulation of servos that hold a pose: whether the robot stands, and which servos are too weak."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from gctd3.robots.actuators import rest_servos
from gctd3.robots.mjcf import driven_joints
from gctd3.robots.stance import UPRIGHT


@dataclass(frozen=True)
class Held:
    """Describe how a robot holds a pose.

    Attributes:
        fell: Time after which it has fallen (s); ``None`` if it stands.
        weak: Indices of the joints whose servos need all of their torque.
        touching: Those of the given sensors that report contact at the end.
    """

    fell: float | None
    weak: tuple[int, ...] = ()
    touching: tuple[int, ...] = ()


def holds(
    model: mujoco.MjModel,
    qpos: np.ndarray,
    root: int,
    sensors: Sequence[int] = (),
    seconds: float = 3.0,
    command: np.ndarray | None = None,
) -> Held:
    """Simulate servos that hold a pose and tell how long the robot stands, and which servos need all of their torque.

    Args:
        model: The model; its actuators are position servos.
        qpos: The pose, shape ``[nq]``.
        root: Index of the robot's root body.
        sensors: Indices in ``sensordata`` of sensors of contact.
        seconds: How long to simulate (s).
        command: Desired angle of each servo, shape ``[nu]`` (rad); those of the pose if ``None``.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    rest_servos(model, data)
    joints = driven_joints(model)
    data.ctrl[:] = [qpos[int(model.jnt_qposadr[j])] for j in joints] if command is None else command
    mujoco.mj_forward(model, data)
    height, upright = float(data.xpos[root, 2]), data.xmat[root].reshape(3, 3).copy()
    floor = height - float(data.geom_xpos[:, 2].min())
    limit = np.where(model.actuator_forcelimited.astype(bool), np.abs(model.actuator_forcerange).min(axis=1), np.inf)
    used, steps = np.zeros(model.nu), max(1, round(seconds / model.opt.timestep))
    for step in range(steps):
        mujoco.mj_step(model, data)
        turned = data.xmat[root].reshape(3, 3) @ upright.T
        if data.time < step * model.opt.timestep or turned[2, 2] < UPRIGHT or data.xpos[root, 2] < height - 0.3 * floor:
            return Held((step + 1) * model.opt.timestep, ())
        if step >= steps // 2:
            used += np.abs(data.actuator_force) > 0.98 * limit
    weak = tuple(int(i) for i in np.flatnonzero(used > 0.8 * (steps - steps // 2)))
    return Held(None, tuple(joints[i] for i in weak), tuple(a for a in sensors if data.sensordata[a] > 0))
