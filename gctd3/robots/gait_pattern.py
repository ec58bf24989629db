"""When each foot swings: the order of the steps of legs that take turns, and how often."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from gctd3.robots.robot import Robot

GRAVITY = 9.81  # m/s^2


@dataclass(frozen=True)
class GaitPattern:
    """Describe a gait by its frequency and the feet's phases. A foot swings in the first half of its period.

    Attributes:
        frequency: Strides per second (Hz).
        phases: Phase of each foot when an episode begins, in [0, 1), shape ``[feet]`` (periods).
    """

    frequency: float
    phases: np.ndarray


def alternating_phases(robot: Robot) -> np.ndarray:
    """Return phases at which left and right feet, and the feet of neighbouring pairs of legs, take turns.

    That is a walk of two legs, the trot of four and the tripod gait of six (Alexander 1984). An episode begins in the
    middle of swings, when each foot passes its place in the standing pose.

    Returns:
        Phases of the feet in [0, 1), shape ``[feet]`` (periods).
    """
    data = mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    mujoco.mj_forward(robot.model, data)
    places = np.array([robot.base.frame @ robot.foot_place(data, foot) for foot in robot.feet])
    pairs = sorted(robot.foot_pairs, key=lambda pair: -float(np.mean(places[list(pair), 0])))
    phases = np.zeros(len(robot.feet))
    for row, pair in enumerate(pairs):
        # To the left is positive.
        from_left = sorted(pair, key=lambda foot: -places[foot, 1])
        for turn, foot in enumerate(from_left):
            phases[foot] = 0.25 + 0.5 * ((row + turn) % 2)
    return phases


def stride_frequency(leg_length: float, froude: float) -> float:
    """Return the strides per second of animals at a Froude number.

    The length of a stride is ``2.3 L Fr^0.3``, and the speed ``sqrt(Fr g L)`` (Alexander 1976, Nature 261:129-130).

    Args:
        leg_length: Length ``L`` of the legs (m).
        froude: Froude number ``v^2 / (g L)``.
    """
    return math.sqrt(froude * GRAVITY * leg_length) / (2.3 * leg_length * froude**0.3)
