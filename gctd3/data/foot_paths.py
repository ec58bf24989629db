"""Paths of feet in a stride, and the actions by which feet take them."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import torch
from torch import Tensor

from gctd3.errors import ConfigError
from gctd3.robots.robot import Robot

FEWEST_JOINTS = 5  # of a leg that can place its foot and turn its sole too
SOLE = 0.3  # leg lengths: an error of the sole's angle counts as much as one of its place at this distance


def foot_way(phase: Tensor, duty: Tensor) -> Tensor:
    """Return how far a foot is forwards in a stride, from -1 to 1.

    On the ground it moves backwards at a constant speed, as the ground does below a body of constant speed. In the air
    it moves forwards with the least jerk (Flash & Hogan 1985) beside that speed, so that it neither jerks nor slides
    when it lifts off and touches down.

    Args:
        phase: Phase of the foot, ``[*]`` (periods); the middle of its swing is at a quarter.
        duty: Share of a period in which it goes backwards, ``[*]``.

    Returns:
        Places in halves of its way, ``[*]``, which it overshoots by up to 0.2 in the air.
    """
    swing = ((phase + 0.25) % 1.0 - 0.5) / (1.0 - duty) + 0.5
    stance = ((phase - 0.25) % 1.0 - 0.5) / duty + 0.5
    back = 2.0 * (1.0 - duty) / duty  # of the ground, while the foot swings
    air = (2.0 + back) * swing**3 * ((6.0 * swing - 15.0) * swing + 10.0) - back * swing - 1.0
    return torch.where((swing > 0.0) & (swing < 1.0), air, 1.0 - 2.0 * stance)


def foot_height(phase: Tensor, softness: Tensor) -> Tensor:
    """Return how high a foot is in a stride, from 0 to 1: a power of a sine in the first half of its period.

    That is longer than it goes forwards, so that a leg that its load has bent is unloaded before, and loaded after.

    Args:
        phase: Phase of the foot, ``[*]`` (periods).
        softness: The power, ``[*]``; it touches down at a speed of 0 if above 1.
    """
    return torch.sin(2 * math.pi * phase).clamp(min=0.0) ** softness


def foot_groups(robot: Robot) -> tuple[Tensor, Tensor]:
    """Return the number of each foot's pair, and the phase by which the second foot of a pair lags, each ``[feet]``."""
    group, lag, count = [-1] * len(robot.feet), [0.0] * len(robot.feet), 0
    for foot, other in enumerate(robot.mirror_feet):
        if group[foot] < 0:
            group[foot] = group[other] = count
            lag[other] = 0.5 if other != foot else 0.0
            count += 1
    return torch.tensor(group), torch.tensor(lag)


def joint_paths(robot: Robot, damping: float, soles: bool = False) -> Tensor:
    """Return the actions by which each foot moves forwards, to the side and up, and by which its sole turns.

    They are the damped pseudo-inverse of the leg's Jacobian (Nakamura & Hanafusa 1986): a straight leg asks for no
    endless angles.

    Args:
        robot: The robot.
        damping: Damping (m).
        soles: Whether legs with joints enough keep their soles level while the feet move, and can turn them.

    Returns:
        Actions, ``[feet, 3, A]`` (1/m), or with ``soles`` ``[feet, 5, A]``: pitch, nose down, and roll, right side down
        (1/rad), follow, and are 0 of legs with fewer joints.

    Raises:
        ConfigError: If no foot has a driven joint of its own.
    """
    model, data = robot.model, mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    mujoco.mj_forward(model, data)
    scale = robot.action_map[1]
    paths = np.zeros((len(robot.feet), 5 if soles else 3, len(robot.actuated)))
    for i, (foot, leg) in enumerate(zip(robot.feet, robot.legs, strict=True)):
        shared = {joint.name for k, other in enumerate(robot.legs) if k != i for joint in other}
        own = [joint for joint in leg if joint.name not in shared and joint.name in robot.actuated]
        moves, turns = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, moves, turns, robot.foot_place(data, foot), robot.foot_bodies[i])
        moves, turns = (robot.base.frame @ one[:, [joint.qvel for joint in own]] for one in (moves, turns))
        rows, units = moves, np.ones((3, 1))
        if soles and len(own) >= FEWEST_JOINTS:
            arm = SOLE * robot.leg_length
            rows, units = np.vstack([moves, arm * turns[[1, 0]]]), np.array([[1.0], [1.0], [1.0], [arm], [arm]])
        inverse = rows.T @ np.linalg.inv(rows @ rows.T + damping**2 * np.eye(len(rows)))
        columns = [robot.actuated.index(joint.name) for joint in own]
        paths[i][: len(rows), columns] = units * inverse.T / scale[columns]
    if not paths.any():
        raise ConfigError(
            "exploration.warmup must not be stepping: no foot of the robot has a driven joint of its own."
        )
    return torch.from_numpy(paths).float()


def foot_places(robot: Robot) -> Tensor:
    """Return where feet stand: forward and to the left of the middle of all feet, ``[feet, 2]`` (m)."""
    data = mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    mujoco.mj_kinematics(robot.model, data)
    places = np.array([robot.base.frame @ robot.foot_place(data, foot) for foot in robot.feet])[:, :2]
    return torch.from_numpy(places - places.mean(axis=0)).float()


def foot_arcs(robot: Robot, paths: Tensor) -> Tensor:
    """Return by how much each foot rises on its way forwards and backwards, ``[feet]``: ``arc * way^2``, leg lengths.

    Joint angles that are proportional to the way of a foot let it go along an arc. It is measured at 0.3 leg lengths.
    """
    model, data = robot.model, mujoco.MjData(robot.model)
    scale, address = robot.action_map[1], [robot.joint(name).qpos for name in robot.actuated]
    far, length = 0.3, robot.leg_length

    def place(foot: int, way: float) -> np.ndarray:
        data.qpos[:] = robot.standing_qpos
        data.qpos[address] += way * length * paths[foot, 0].numpy() * scale
        mujoco.mj_kinematics(model, data)
        return robot.base.frame @ robot.foot_place(data, robot.feet[foot])

    rises = []
    for foot in range(len(robot.feet)):
        back, middle, front = (place(foot, way) for way in (-far, 0.0, far))
        rises.append(((front + back) / 2 - middle)[2] / (far**2 * length))
    return torch.tensor(rises, dtype=torch.float32)
