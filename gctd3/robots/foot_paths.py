"""Paths of feet about the standing pose: the actions by which each foot moves along an axis or turns its sole."""

from __future__ import annotations

import mujoco
import numpy as np

from gctd3.errors import ConfigError
from gctd3.robots.robot import Robot

AXES = ("forward", "side", "up", "sole_pitch", "sole_roll")
FEWEST_JOINTS = 5  # of a leg that can place its foot and turn its sole too
SOLE = 0.3  # leg lengths: an error of the sole's angle counts as much as one of its place at this distance


def joint_paths(robot: Robot, damping: float, soles: bool) -> np.ndarray:
    """Compute the actions by which each foot moves forwards, to the side and up, and by which its sole turns.

    They are the damped pseudo-inverse of the leg's Jacobian (Nakamura & Hanafusa 1986): a straight leg asks for no
    endless angles.

    Args:
        robot: The robot.
        damping: Damping (m).
        soles: Whether legs with joints enough keep their soles level while the feet move, and can turn them: nose down
            and right side down are positive.

    Returns:
        Actions, shape ``[feet, 5, A]``, a row for each of ``AXES`` (1/m and 1/rad); zeros where a sole cannot turn.

    Raises:
        ConfigError: If no foot has a driven joint of its own.
    """
    model, data = robot.model, mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    mujoco.mj_forward(model, data)
    scale = robot.action_map[1]
    paths = np.zeros((len(robot.feet), len(AXES), len(robot.actuated)))
    for i, (foot, leg) in enumerate(zip(robot.feet, robot.legs, strict=True)):
        shared = {joint.name for k, other in enumerate(robot.legs) if k != i for joint in other}
        own = [joint for joint in leg if joint.name not in shared and joint.name in robot.actuated]
        moves, turns = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, moves, turns, robot.foot_place(data, foot), robot.foot_bodies[i])
        columns = [joint.qvel for joint in own]
        rows = robot.base.frame @ moves[:, columns]
        units = np.ones(3)
        if soles and len(own) >= FEWEST_JOINTS:
            arm = SOLE * robot.leg_length
            roll, pitch, _ = robot.base.frame @ turns[:, columns]
            rows = np.vstack([rows, arm * pitch, arm * roll])
            units = np.array([1.0, 1.0, 1.0, arm, arm])
        inverse = rows.T @ np.linalg.inv(rows @ rows.T + damping**2 * np.eye(len(rows)))
        actions = [robot.actuated.index(joint.name) for joint in own]
        paths[i, : len(rows), actions] = inverse * units / scale[actions][:, None]
    if not paths.any():
        raise ConfigError(
            "exploration.warmup must not be stepping: no foot of the robot has a driven joint of its own."
        )
    return paths


def arcs(robot: Robot, paths: np.ndarray) -> np.ndarray:
    """Compute by how much each foot rises on its way forwards and backwards: ``arc * way^2``.

    Joint angles that are proportional to the way of a foot let it go along an arc. It is measured at 0.3 leg lengths.

    Args:
        robot: The robot.
        paths: What :func:`joint_paths` returns.

    Returns:
        The arcs, shape ``[feet]`` (1/leg length).
    """
    model, data = robot.model, mujoco.MjData(robot.model)
    scale, address = robot.action_map[1], [robot.joint(name).qpos for name in robot.actuated]
    far, length = 0.3, robot.leg_length

    def place(foot: int, way: float) -> np.ndarray:
        data.qpos[:] = robot.standing_qpos
        data.qpos[address] += way * length * paths[foot, 0] * scale
        mujoco.mj_kinematics(model, data)
        return robot.base.frame @ robot.foot_place(data, robot.feet[foot])

    rises = []
    for foot in range(len(robot.feet)):
        back, middle, front = (place(foot, way) for way in (-far, 0.0, far))
        rises.append(((front + back) / 2 - middle)[2] / (far**2 * length))
    return np.array(rises)


def sides(robot: Robot) -> np.ndarray:
    """Return 1 for each foot on the left, -1 for one on the right, and 0 for one in the middle, shape ``[feet]``."""
    data = mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    mujoco.mj_forward(robot.model, data)
    left = np.array([(robot.base.frame @ robot.foot_place(data, foot))[1] for foot in robot.feet])
    away = left - left.mean()
    return np.where(np.abs(away) > 0.01 * robot.leg_length, np.sign(away), 0.0)
