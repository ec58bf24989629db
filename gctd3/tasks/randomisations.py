"""Randomisations of the initial state of an episode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gctd3.errors import check_between
from gctd3.robots.loops import close_loops
from gctd3.robots.robot import Robot
from gctd3.tasks.terms import Randomisation


@dataclass(frozen=True)
class JointNoise(Randomisation):
    """Add uniform noise to the initial angle and velocity of every joint.

    Attributes:
        angle: Largest deviation of a joint's angle from the pose in which episodes begin (rad).
        velocity: Largest deviation of a joint's velocity from zero (rad/s).
    """

    angle: float = 0.05
    velocity: float = 0.1

    def __post_init__(self) -> None:
        check_between(self, 0, 10, "angle")
        check_between(self, 0, 1000, "velocity")

    def __call__(
        self, rng: np.random.Generator | np.random.RandomState, robot: Robot, qpos: np.ndarray, qvel: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return pose and velocities with noise on the joints, drawn for the angles first, then for the velocities.

        Closed loops stay closed: joints that nothing drives follow the others.
        """
        qpos, qvel, count = qpos.copy(), qvel.copy(), len(robot.joints)
        qpos[[joint.qpos for joint in robot.joints]] += rng.uniform(-self.angle, self.angle, count)
        qvel[[joint.qvel for joint in robot.joints]] += rng.uniform(-self.velocity, self.velocity, count)
        return close_loops(robot.model, qpos, qvel, robot.inner_joints)
