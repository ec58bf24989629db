"""MuJoCo behind the same interface: the robot's own model with its own servos, armature and time step."""

from __future__ import annotations

from typing import ClassVar

import mujoco
import numpy as np

from gctd3.engines.engine import Engine
from gctd3.envs.simulation import substeps_of
from gctd3.robots.actuators import rest_servos
from gctd3.robots.ground import contact_sensors
from gctd3.robots.robot import Robot


class Reference(Engine):
    """Simulate a robot in MuJoCo, as trainings and evaluations do.

    Args:
        robot: The robot.
        control_dt: Control period (s).
    """

    name: ClassVar[str] = "mujoco"

    def __init__(self, robot: Robot, control_dt: float) -> None:
        self.robot, self.model = robot, robot.model
        self.data = mujoco.MjData(robot.model)
        self.substeps = substeps_of(control_dt, robot)
        self.torque = np.zeros((self.substeps, robot.model.nu))
        self._sensors = contact_sensors(robot.model, robot.base.root)

    def reset(self, qpos: np.ndarray, qvel: np.ndarray, above: float = 0.0) -> None:
        """Put the robot into a state, and ``above`` (m) higher."""
        model, data = self.model, self.data
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = qpos, qvel
        height = self.robot.base.height
        if above and height is not None:
            data.qpos[height.qpos] += above * height.sign
        rest_servos(model, data)
        mujoco.mj_forward(model, data)

    def advance(self, desired: np.ndarray) -> None:
        """Simulate a control period with desired angles at the servos."""
        data = self.data
        data.ctrl[:] = desired
        for i in range(self.substeps):
            mujoco.mj_step(self.model, data)
            self.torque[i] = data.actuator_force

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """Return ``qpos`` and ``qvel``."""
        return self.data.qpos.copy(), self.data.qvel.copy()

    def touching(self) -> frozenset[str]:
        """Return the names of the bodies whose contact sensors count the ground, as the task reads them."""
        return frozenset(name for name, sensor in self._sensors.items() if self.data.sensordata[sensor] > 0)
