"""Open-loop gaits whose feet step: they evolve during the warm-up, and training starts from their transitions."""

from __future__ import annotations

import math
from collections.abc import Mapping

import mujoco
import numpy as np
import torch
from torch import Tensor

from gctd3.data.evolution import Evolution
from gctd3.errors import ConfigError
from gctd3.robots.gait_pattern import GRAVITY, GaitPattern
from gctd3.robots.robot import Robot


class Stepping(Evolution):
    """Generate open-loop gaits in which every foot moves to and fro and is lifted on its way forwards.

    The path of a foot about its place in the standing pose becomes joint angles by the pseudo-inverse of its leg's
    Jacobian, less the arc that it would go along. On the ground a foot moves as the ground does below a body of
    constant speed, and it touches down and lifts off at that speed, so that it need not slide. Left and right feet
    step half a period apart; the phases of the pairs, frequency, length and height of the steps, a shift of each pair
    of feet, a crouch and a sway are drawn, and evolve (:class:`.Evolution`). Lengths are in leg lengths and frequencies
    in those of a pendulum as long as the leg, so that the same numbers serve robots of all sizes.

    Args:
        robot: The robot.
        num_robots: Number of robots.
        trial: Time for which a gait is tried (s).
        control_dt: Control period (s).
        mutation_share: Share of new gaits that descend from others.
        gait: Frequency and phases of the feet of all gaits; they evolve if ``None``.
        steps: Control steps of the warm-up; ``None`` for one without an end.
        least_speed: Speed below which a gait is less fit (m/s); ``None`` for the reward alone.

    Raises:
        ConfigError: If no foot has a driven joint of its own.
    """

    pair_of: Tensor
    lagging: Tensor
    joints: Tensor
    arc: Tensor

    GENES: Mapping[str, tuple[float, float, bool]] = {
        "frequency": (1.0, 3.2, False),  # of a pendulum as long as the leg
        "stride": (0.05, 0.45, False),  # half of a foot's way to and fro, leg lengths
        "lift": (0.05, 0.5, False),  # leg lengths
        "duty": (0.5, 0.75, False),  # share of a period in which a foot goes backwards
        "softness": (1.0, 2.0, False),  # of lifting off and touching down: power of the sine of the height
        "lead": (-0.05, 0.15, False),  # of the way, since servos take their time; periods
        "lag": (-0.1, 0.1, False),  # of the lift, periods; below 0 it is later
        "crouch": (-0.2, 0.1, False),  # leg lengths; below 0 legs stretch against what they carry
        "sway": (-0.1, 0.1, False),  # of the body to the side, leg lengths
        "sway_phase": (0.0, 1.0, False),  # periods
        "shift": (-0.15, 0.15, True),  # of a pair of feet forwards, leg lengths
        "phase": (0.0, 1.0, True),  # of a pair of feet, periods
    }
    CYCLIC = ("phase", "sway_phase")
    DAMPING = 0.05  # of the pseudo-inverse, leg lengths

    def __init__(
        self,
        robot: Robot,
        num_robots: int,
        trial: float,
        control_dt: float,
        mutation_share: float = 0.8,
        gait: GaitPattern | None = None,
        steps: int | None = None,
        least_speed: float | None = None,
    ) -> None:
        length = robot.leg_length
        pendulum = math.sqrt(GRAVITY / length) / (2 * math.pi)
        group, lag = _groups(robot)
        groups, fixed = int(group.max()) + 1, dict[str, Tensor]()
        if gait is not None:
            # Of a robot whose feet are no mirror images, each foot has the phase that the gait gives it.
            phases = torch.from_numpy(gait.phases).float()
            firsts = phases[[int((group == pair).nonzero()[0]) for pair in range(groups)]]
            lag = phases - firsts[group]
            fixed = {"frequency": torch.tensor(gait.frequency / pendulum), "phase": firsts}
        super().__init__(num_robots, groups, trial, control_dt, mutation_share, steps, pendulum, fixed, least_speed)
        self._length = length
        self.register_buffer("pair_of", group, persistent=False)
        self.register_buffer("lagging", lag, persistent=False)
        self.register_buffer("joints", _joint_paths(robot, self.DAMPING * length), persistent=False)
        self.register_buffer("arc", _arcs(robot, self.joints), persistent=False)

    def act(self, genes: Mapping[str, Tensor], cycles: Tensor) -> Tensor:
        """Return the actions ``[*, A]`` of gaits after ``cycles`` periods, ``[*]``; they are not clipped."""
        turn = 2 * math.pi
        phase = cycles[:, None] + genes["phase"][:, self.pair_of] + self.lagging
        lead, lag, duty, softness = (genes[name][:, None] for name in ("lead", "lag", "duty", "softness"))
        way, lift = foot_way(phase + lead, duty), foot_height(phase + lag, softness)
        forward = genes["shift"][:, self.pair_of] + genes["stride"][:, None] * way
        up = genes["crouch"][:, None] + genes["lift"][:, None] * lift - self.arc * forward.square()
        sway = genes["sway"] * torch.sin(turn * (cycles + genes["sway_phase"]))
        side = sway[:, None].expand_as(up)
        return torch.einsum("nfd,fda->na", self._length * torch.stack([forward, side, up], dim=-1), self.joints)


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


def _groups(robot: Robot) -> tuple[Tensor, Tensor]:
    """Return the number of each foot's pair, and the phase by which the second foot of a pair lags, each ``[feet]``."""
    group, lag, count = [-1] * len(robot.feet), [0.0] * len(robot.feet), 0
    for foot, other in enumerate(robot.mirror_feet):
        if group[foot] < 0:
            group[foot] = group[other] = count
            lag[other] = 0.5 if other != foot else 0.0
            count += 1
    return torch.tensor(group), torch.tensor(lag)


def _joint_paths(robot: Robot, damping: float) -> Tensor:
    """Return the actions by which each foot moves forwards, to the side and up: ``[feet, 3, A]`` (1/m)."""
    model, data = robot.model, mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    mujoco.mj_forward(model, data)
    scale = robot.action_map[1]
    paths = np.zeros((len(robot.feet), 3, len(robot.actuated)))
    for i, (foot, leg) in enumerate(zip(robot.feet, robot.legs, strict=True)):
        shared = {joint.name for k, other in enumerate(robot.legs) if k != i for joint in other}
        own = [joint for joint in leg if joint.name not in shared and joint.name in robot.actuated]
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, jacobian, None, robot.foot_place(data, foot), robot.foot_bodies[i])
        moved = robot.base.frame @ jacobian[:, [joint.qvel for joint in own]]
        # Damped least squares (Nakamura & Hanafusa 1986): a straight leg asks for no endless angles.
        inverse = moved.T @ np.linalg.inv(moved @ moved.T + damping**2 * np.eye(3))
        columns = [robot.actuated.index(joint.name) for joint in own]
        paths[i][:, columns] = inverse.T / scale[columns]
    if not paths.any():
        raise ConfigError(
            "exploration.warmup must not be stepping: no foot of the robot has a driven joint of its own."
        )
    return torch.from_numpy(paths).float()


def _arcs(robot: Robot, paths: Tensor) -> Tensor:
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
