"""From the state of a simulator to a measurement of the robot."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gctd3.robots.robot import Robot
from gctd3.tasks.measurement import Measurement
from gctd3.tasks.terms import RobotFacts


class StateReader:
    """Read measurements of a robot from a simulator's state.

    Args:
        robot: The robot.
        facts: Its facts, with the ground that it walks on.
    """

    def __init__(self, robot: Robot, facts: RobotFacts) -> None:
        self._extra, self._ground = facts.base, facts.ground
        self._base = robot.base
        standing = self._base.read(robot.standing_qpos, np.zeros(robot.model.nv))
        self._standing = {name: value for name, (value, _) in standing.items()}
        self._feet = robot.contact_sensors(robot.feet)
        self._foot_velocities = robot.foot_velocity_sensors
        self._shanks = robot.contact_sensors(robot.shanks)
        self._others = robot.contact_sensors(robot.other_contact_bodies)
        self._qpos = np.array([joint.qpos for joint in robot.joints])
        self._qvel = np.array([joint.qvel for joint in robot.joints])

    def __call__(
        self, qpos: np.ndarray, qvel: np.ndarray, sensordata: np.ndarray, spot: Mapping[str, np.ndarray] | None = None
    ) -> Measurement:
        """Return the measurement of a state; see :meth:`.SimulatedTask.measure`."""
        read = self._base.read(qpos, qvel)
        place = {name: np.asarray(value - self._standing[name]) for name, (value, _) in read.items()}
        if self._ground is not None:
            place = self._ground.relative(place, spot)
        if self._extra:
            base = np.stack([np.stack([place[name], read[name][1]], axis=-1) for name in self._extra], axis=-2)
            upright = np.cos(place.get("roll", 0.0)) * np.cos(place.get("pitch", 0.0))
            tilt = np.broadcast_to(np.arccos(np.clip(upright, -1.0, 1.0)), qpos.shape[:-1])
        else:
            base, tilt = np.zeros((*qpos.shape[:-1], 0, 2)), np.zeros(qpos.shape[:-1])
        return Measurement(
            position=place["forward"],
            height=place["height"],
            velocity=np.asarray(read["forward"][1]),
            # Indexing would give another memory layout than a checkpoint has, and sums would differ in their last bits.
            angles=qpos.take(self._qpos, axis=-1),
            velocities=qvel.take(self._qvel, axis=-1),
            feet_down=sensordata.take(self._feet, axis=-1) > 0,
            other_down=np.asarray((sensordata.take(self._others, axis=-1) > 0).any(axis=-1)),
            shank_down=np.asarray((sensordata.take(self._shanks, axis=-1) > 0).any(axis=-1)),
            base=base,
            tilt=tilt,
            feet_velocity=self._velocity_of_feet(sensordata),
        )

    def _velocity_of_feet(self, sensordata: np.ndarray) -> np.ndarray:
        if self._foot_velocities is None:
            return np.zeros((*sensordata.shape[:-1], 0, 3))
        return np.asarray(sensordata.take(self._foot_velocities, axis=-1) @ self._base.frame.T)
