"""DART, the default engine of Gazebo Sim, by its Python package ``dartpy``."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from gctd3.engines.engine import OtherEngine, Pose, ground_friction
from gctd3.robots.links import WORLD

_GROUND = (400.0, 400.0, 1.0)  # m
_ROUGH = 1e3  # friction of the ground: of two DART takes the smaller


class Dart(OtherEngine):
    """Simulate a robot in DART."""

    name: ClassVar[str] = "dart"

    def open(self) -> None:
        """Load the URDF, and build the ground."""
        import dartpy

        self._dart: Any = dartpy
        dynamics = dartpy.dynamics
        self._skeleton = skeleton = dartpy.utils.DartLoader().parseSkeleton(str(self.file.absolute()))
        self._index = np.array([skeleton.getJoint(name).getIndexInSkeleton(0) for name in self.joints])
        for name, friction in zip(self.joints, self.friction, strict=True):
            joint = skeleton.getJoint(name)
            # DART reads limits and enforces none, and its damping is not the joint's of MuJoCo.
            joint.setLimitEnforcement(True)
            joint.setDampingCoefficient(0, 0.0)
            joint.setCoulombFriction(0, float(friction))
        self._names = {body.getName() for body in skeleton.getBodyNodes()}
        surfaces = ground_friction(self.robot)
        for body in skeleton.getBodyNodes():
            for node in body.getShapeNodes():
                if node.hasDynamicsAspect():
                    node.getDynamicsAspect().setFrictionCoeff(surfaces.get(body.getName(), 1.0))
        ground = dynamics.Skeleton("ground")
        _, body = ground.createWeldJointAndBodyNodePair()
        body.setName(WORLD)
        node = body.createShapeNode(dynamics.BoxShape(list(_GROUND)))
        node.createCollisionAspect()
        node.createDynamicsAspect().setFrictionCoeff(_ROUGH)
        node.setRelativeTranslation([0.0, 0.0, -_GROUND[2] / 2])
        self._world = world = dartpy.simulation.World()
        world.setTimeStep(self.timestep)
        world.setGravity(self.robot.model.opt.gravity.tolist())
        # As in Gazebo Sim.
        world.getConstraintSolver().setCollisionDetector(dartpy.collision.OdeCollisionDetector())
        world.addSkeleton(ground)
        world.addSkeleton(skeleton)
        self._force = np.zeros(skeleton.getNumDofs())

    def put(self, angles: np.ndarray, rates: np.ndarray, base: Pose | None) -> None:
        """Put joints and base where they are asked for."""
        skeleton = self._skeleton
        positions, velocities = np.zeros(len(self._force)), np.zeros(len(self._force))
        positions[self._index], velocities[self._index] = angles, rates
        skeleton.resetCommands()
        skeleton.resetGeneralizedForces()
        skeleton.clearConstraintImpulses()
        skeleton.setPositions(positions)
        skeleton.setVelocities(velocities)
        skeleton.resetAccelerations()
        if base is not None:
            joint = skeleton.getRootJoint()
            transform = self._dart.math.Isometry3()
            transform.set_rotation(base.turn)
            transform.set_translation(base.place)
            joint.setRelativeTransform(transform)
            # Its own frame's: angular first.
            joint.setRelativeSpatialVelocity(np.concatenate([base.turn.T @ base.rate, base.turn.T @ base.velocity]))
        self._world.getConstraintSolver().clearLastCollisionResult()

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the joints' angles and velocities."""
        return self._skeleton.getPositions()[self._index], self._skeleton.getVelocities()[self._index]

    def read_base(self) -> Pose:
        """Return the state of a free base."""
        root = self._skeleton.getRootBodyNode()
        transform = root.getWorldTransform()
        return Pose(
            np.ravel(transform.translation()),
            np.asarray(transform.rotation()),
            np.ravel(root.getLinearVelocity()),
            np.ravel(root.getAngularVelocity()),
        )

    def step(self, torque: np.ndarray) -> None:
        """Take a step of the physics."""
        self._force[self._index] = torque
        self._skeleton.setForces(self._force)
        self._world.step()

    def touching(self) -> frozenset[str]:
        """Return the names of the bodies that touch the ground."""
        result = self._world.getLastCollisionResult()
        touched = {body.getName() for body in result.getCollidingBodyNodes()}
        return frozenset(touched & self._names)
