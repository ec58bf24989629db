"""A robot with other masses, friction, centre of mass or gains than its file's, and the effect of a push on it."""

from __future__ import annotations

import copy
from dataclasses import replace

import mujoco
import numpy as np

from gctd3.robots.mjcf import bodies_below
from gctd3.robots.robot import Robot


def altered_model(
    robot: Robot,
    mass: float = 1.0,
    friction: float = 1.0,
    gains: float = 1.0,
    centre_of_mass: np.ndarray | None = None,
) -> mujoco.MjModel:
    """Copy a robot's model, with other numbers.

    MuJoCo takes the larger friction of two surfaces in contact, so that of the ground changes with that of the soles.

    Args:
        robot: The robot.
        mass: Factor of all its masses and inertias.
        friction: Factor of all friction of the model.
        gains: Factor of the servos' stiffness and damping.
        centre_of_mass: Shift of the root body's centre of mass in the body's axes, shape ``[3]`` (m).
    """
    model = copy.deepcopy(robot.model)
    bodies = bodies_below(model, robot.base.root)
    model.body_mass[bodies] *= mass
    model.body_inertia[bodies] *= mass
    model.geom_friction[:] *= friction
    model.pair_friction[:] *= friction
    model.actuator_gainprm[:, 0] *= gains
    model.actuator_biasprm[:, 1:3] *= gains
    if centre_of_mass is not None:
        model.body_ipos[robot.base.root] += centre_of_mass
    # Recompute the constants that MuJoCo derives from the masses.
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def altered(robot: Robot, mass: float = 1.0, friction: float = 1.0) -> Robot:
    """Return the robot with all its masses and inertias, and all friction, scaled; see :func:`altered_model`."""
    return replace(robot, model=altered_model(robot, mass, friction))


def velocity_change(
    robot: Robot, qpos: np.ndarray, impulse: np.ndarray, model: mujoco.MjModel | None = None
) -> np.ndarray:
    """Compute the velocity change by an impulse at the root body's centre of mass: ``M(q)^-1 J(q)^T p``.

    Args:
        robot: The robot.
        qpos: Its pose, shape ``[nq]``.
        impulse: ``p`` in the world's axes, shape ``[3]`` (N s).
        model: Its model if it is altered; the robot's own if ``None``.

    Returns:
        Change of the generalised velocities, shape ``[nv]``.
    """
    model = robot.model if model is None else model
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_fwdPosition(model, data)
    jacobian, change = np.zeros((3, model.nv)), np.zeros((1, model.nv))
    mujoco.mj_jacBodyCom(model, data, jacobian, None, robot.base.root)
    mujoco.mj_solveM(model, data, change, (jacobian.T @ impulse)[None])
    return change[0]


def resting_action(robot: Robot) -> np.ndarray:
    """Return the action that commands the servos to the pose in which episodes begin, shape ``[A]``, in [-1, 1]."""
    model = robot.model
    angles = robot.start_qpos[model.jnt_qposadr[model.actuator_trnid[:, 0]]] * model.actuator_gear[:, 0]
    centre, scale = robot.action_map
    return np.asarray(np.clip((angles - centre) / scale, -1.0, 1.0))
