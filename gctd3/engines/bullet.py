"""Bullet, by its Python package ``pybullet``."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, ClassVar

import numpy as np

from gctd3.engines.engine import OtherEngine, Pose, ground_friction


class Bullet(OtherEngine):
    """Simulate a robot in Bullet."""

    name: ClassVar[str] = "bullet"

    def open(self) -> None:
        """Load the URDF, and build the ground."""
        with _silent():
            import pybullet
            from pybullet_utils.bullet_client import BulletClient

            self._bullet: Any = BulletClient(connection_mode=pybullet.DIRECT)
            bullet = self._bullet
            bullet.setGravity(*self.robot.model.opt.gravity.tolist())
            bullet.setTimeStep(self.timestep)
            # Else a file that is written anew would be read as it was.
            bullet.setPhysicsEngineParameter(enableFileCaching=0)
            self._ground = bullet.createMultiBody(0, bullet.createCollisionShape(bullet.GEOM_PLANE))
            self._body = bullet.loadURDF(
                str(self.file.absolute()), useFixedBase=self.free is None, flags=bullet.URDF_USE_INERTIA_FROM_FILE
            )
        # Of two frictions Bullet takes the product.
        bullet.changeDynamics(self._ground, -1, lateralFriction=1.0)
        infos = [bullet.getJointInfo(self._body, i) for i in range(bullet.getNumJoints(self._body))]
        names, self._links = [info[1].decode() for info in infos], {info[0]: info[12].decode() for info in infos}
        self._links[-1] = bullet.getBodyInfo(self._body)[0].decode()
        self._index = [names.index(name) for name in self.joints]
        surfaces = ground_friction(self.robot)
        for link, name in self._links.items():
            bullet.changeDynamics(
                self._body,
                link,
                linearDamping=0.0,
                angularDamping=0.0,
                jointDamping=0.0,
                lateralFriction=surfaces.get(name, 1.0),
                spinningFriction=0.0,
                rollingFriction=0.0,
                maxJointVelocity=1e3,
            )
        # Joints have motors that hold them; one that wants no motion with a joint's friction is that friction.
        bullet.setJointMotorControlArray(
            self._body,
            self._index,
            bullet.VELOCITY_CONTROL,
            targetVelocities=[0.0] * len(self._index),
            forces=self.friction.tolist(),
        )
        offset = bullet.getDynamicsInfo(self._body, -1)
        # Bullet moves a base by its centre of mass, along its principal axes.
        self._centre = np.array(offset[3])
        self._principal = np.array(bullet.getMatrixFromQuaternion(offset[4])).reshape(3, 3)

    def put(self, angles: np.ndarray, rates: np.ndarray, base: Pose | None) -> None:
        """Put joints and base where they are asked for."""
        bullet = self._bullet
        if base is not None:
            arm = base.turn @ self._centre
            turn = _quaternion(base.turn @ self._principal)
            bullet.resetBasePositionAndOrientation(self._body, (base.place + arm).tolist(), turn.tolist())
            velocity = base.velocity + np.cross(base.rate, arm)
            bullet.resetBaseVelocity(self._body, velocity.tolist(), base.rate.tolist())
        for index, angle, rate in zip(self._index, angles.tolist(), rates.tolist(), strict=True):
            bullet.resetJointState(self._body, index, angle, rate)

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the joints' angles and velocities."""
        states = self._bullet.getJointStates(self._body, self._index)
        return np.array([state[0] for state in states]), np.array([state[1] for state in states])

    def read_base(self) -> Pose:
        """Return the state of a free base."""
        bullet = self._bullet
        place, quaternion = bullet.getBasePositionAndOrientation(self._body)
        velocity, rate = (np.array(values) for values in bullet.getBaseVelocity(self._body))
        turn = np.array(bullet.getMatrixFromQuaternion(quaternion)).reshape(3, 3) @ self._principal.T
        arm = turn @ self._centre
        return Pose(np.array(place) - arm, turn, velocity - np.cross(rate, arm), rate)

    def step(self, torque: np.ndarray) -> None:
        """Take a step of the physics."""
        bullet = self._bullet
        bullet.setJointMotorControlArray(self._body, self._index, bullet.TORQUE_CONTROL, forces=torque.tolist())
        bullet.stepSimulation()

    def touching(self) -> frozenset[str]:
        """Return the names of the bodies that touch the ground."""
        contacts = self._bullet.getContactPoints(bodyA=self._body, bodyB=self._ground)
        # Points are kept that are near each other; those with a force touch.
        return frozenset(self._links[contact[3]] for contact in contacts or () if contact[9] > 0.0)


def _quaternion(turn: np.ndarray) -> np.ndarray:
    """Return the quaternion of a rotation as Bullet has it, the scalar last."""
    import mujoco

    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, turn.ravel())
    return np.roll(quaternion, -1)


@contextmanager
def _silent() -> Iterator[None]:
    """Keep what Bullet prints when it is imported and reads a file, past Python, from the terminal."""
    null = os.open(os.devnull, os.O_WRONLY)
    kept = [os.dup(stream) for stream in (1, 2)]
    try:
        for stream in (1, 2):
            os.dup2(null, stream)
        yield
    finally:
        for stream, own in zip((1, 2), kept, strict=True):
            os.dup2(own, stream)
            os.close(own)
        os.close(null)
