"""The desired angles that hold a robot in its standing pose against its weight."""

from __future__ import annotations

import copy

import mujoco
import numpy as np

from gctd3.robots.actuators import torque_limit
from gctd3.robots.robot import Robot

SECONDS = 1.0  # s: the robot is held for so long
AVERAGED = 0.25  # of that time, at its end
NATURAL_FREQUENCY = 2.0 * np.pi * 15.0  # rad/s, of the springs that hold it, at most
STABLE = 0.2  # radians of their oscillation in a time step, at most
LEAST_UPRIGHT = 0.9  # component along z of the body's vertical


def find_standing_command(robot: Robot) -> np.ndarray:
    """Find the desired angle of each servo that holds the standing pose, shape ``[A]`` (rad).

    A servo carries weight only by an error of its angle: a soft one that is told the standing pose sags. The robot is
    held in the pose by stiff springs for a second; the torque that they need, divided by the servo's stiffness, is
    added to the pose. A robot that tips over meanwhile gets the pose itself.

    Args:
        robot: The robot; every action is a position servo's.
    """
    model = copy.copy(robot.model)
    data = mujoco.MjData(model)
    joints = [robot.joint(name) for name in robot.actuated]
    home = robot.start_qpos[[joint.qpos for joint in joints]]
    dofs = np.array([joint.qvel for joint in joints])
    low, high = robot.action_range.T
    data.qpos[:], data.ctrl[:] = robot.standing_qpos, np.clip(home, low, high)
    mujoco.mj_forward(model, data)
    inertia = np.zeros(len(dofs))
    for i, dof in enumerate(dofs):
        column = np.zeros(model.nv)
        mujoco.mj_mulM(model, data, column, np.eye(model.nv)[dof])
        inertia[i] = column[dof]
    # The springs act beside the solver's own forces, and are stable only where no joint is lighter than they take it to
    # be: a hand at the end of an arm is. Rotors as heavy as all that a joint carries do not change the torque at rest.
    model.dof_armature[dofs] += inertia
    frequency = min(NATURAL_FREQUENCY, STABLE / model.opt.timestep)
    stiffness, damping = inertia * frequency**2, 2.0 * inertia * frequency
    steps = max(round(SECONDS / model.opt.timestep), 1)
    torques = []
    for _ in range(steps):
        away, speed = data.qpos[[joint.qpos for joint in joints]] - home, data.qvel[dofs]
        data.qfrc_applied[dofs] = -stiffness * away - damping * speed
        mujoco.mj_step(model, data)
        torques.append(data.qfrc_applied[dofs] + data.qfrc_actuator[dofs])
    upright = data.xmat[robot.base.root].reshape(3, 3) @ _vertical(robot)
    torque = np.mean(torques[-max(round(AVERAGED * steps), 1) :], axis=0)
    # A simulation that fails begins again from the reference pose.
    failed = any(warning.number for warning in data.warning) or not np.isfinite(torque).all()
    if failed or upright[2] < LEAST_UPRIGHT:
        return np.clip(home, low, high)
    limit = np.array([torque_limit(robot, i) for i in range(len(joints))])
    command = np.clip(home + np.clip(torque, -limit, limit) / model.actuator_gainprm[:, 0], low, high)
    # The two sides alike, although the centre of mass of a real robot is some millimetres off the middle.
    order, sign = robot.action_mirror
    return np.asarray((command + sign * command[order]) / 2.0)


def _vertical(robot: Robot) -> np.ndarray:
    """Return the world's vertical of the standing pose in the root body's frame, shape ``[3]``."""
    data = mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    mujoco.mj_kinematics(robot.model, data)
    return np.asarray(data.xmat[robot.base.root].reshape(3, 3)[2])
