"""The residual of a robot's mirror: how far stepping and reflecting a state differ by their order."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from gctd3.robots.model_reflection import ModelReflection
from gctd3.robots.random_states import RandomStates

STATES = 100  # compared in the air, and as many on the ground


@dataclass(frozen=True)
class Residual:
    """Hold how far stepping and reflecting differ by their order.

    Attributes:
        total: As a part of the motion of one step.
        parts: The same of each degree of freedom alone, shape ``[nv]``.
    """

    total: float
    parts: np.ndarray


def measure_residual(
    image: ModelReflection, model: mujoco.MjModel, steps: int, ground: float | None, states: int = STATES
) -> Residual:
    """Compare reflecting before and after a control step, from random states.

    Args:
        image: The reflection of the robot's model.
        model: The robot's model, or one with other masses.
        steps: Physics steps in a control step.
        ground: Height of the ground that the robot stands on (m); ``None`` for the air.
        states: Number of random states.
    """
    rng, drawn, data = np.random.default_rng(0), RandomStates(image), mujoco.MjData(model)
    robot = image.robot
    enabled = model.opt.disableflags
    order, signs = robot.action_mirror
    centre, scale = robot.action_map
    dofs = [d for joint in image.joints for d in joint.dofs]
    apart, motion, inertia = 0.0, 0.0, np.zeros((model.nv, model.nv))
    parts = np.zeros((2, model.nv))

    def step(qpos: np.ndarray, qvel: np.ndarray, action: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = qpos, qvel
        data.ctrl[list(robot.actuators)] = centre + scale * action
        mujoco.mj_step(model, data, nstep=steps)
        return data.qpos.copy(), data.qvel.copy()

    try:
        if ground is None:
            model.opt.disableflags = int(enabled) | int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        for _ in range(states):
            qpos, qvel = drawn.draw(rng, ground)
            action = rng.uniform(-1.0, 1.0, len(robot.actuated))
            begun, speed = image.states(qpos, qvel)
            _, first = step(begun, speed, signs * action[order])
            _, second = image.states(*step(qpos, qvel, action))
            gap, change = np.zeros(model.nv), np.zeros(model.nv)
            gap[dofs], change[dofs] = (first - second)[dofs], (second - speed)[dofs]
            data.qpos[:] = begun
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_crb(model, data)
            mujoco.mj_fullM(model, data, inertia)
            apart += float(gap @ inertia @ gap)
            motion += float(change @ inertia @ change)
            parts += np.diag(inertia) * np.stack([gap, change]) ** 2
    finally:
        model.opt.disableflags = enabled
    return Residual(float(np.sqrt(apart / max(motion, 1e-300))), np.sqrt(parts[0] / max(motion, 1e-300)))
