"""The left/right mirror of a robot: the images of its joints, bodies, feet and actuators in its sagittal plane."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import mujoco
import numpy as np

from gctd3.robots.feet import foot_place
from gctd3.robots.floating_base import Base
from gctd3.robots.mirror_feet import pair_feet
from gctd3.robots.mirror_pairs import Pairs, pair_joints, reflected_signs, swap_side, zero_pose
from gctd3.robots.mjcf import Joint, body_name, standing_pose


class RobotMirror:
    """Find the mirror images of a robot's parts.

    Args:
        base: The robot's base, with its model.
        joints: The robot's joints.
        legs: The joints of each leg, from the root down.
        feet: Names of the feet's bodies.
        standing: The standing pose, shape ``[nq]``.
    """

    def __init__(
        self,
        base: Base,
        joints: Sequence[Joint],
        legs: Sequence[Sequence[Joint]],
        feet: Sequence[str],
        standing: np.ndarray,
    ) -> None:
        self._base, self._model, self._joints, self._feet, self._standing = base, base.model, joints, feet, standing
        self._ends = [leg[-1].name if leg else None for leg in legs]
        self._bodies = {body_name(base.model, b): b for b in range(base.model.nbody)}

    @cached_property
    def pairs(self) -> Pairs:
        """Return the mirror images of the joints, and the sagittal plane in the standing pose."""
        last = {end for end in self._ends if end is not None}
        return pair_joints(self._model, self._base.root, self._joints, self._standing, self._base.frame[1], last)

    @cached_property
    def signs(self) -> dict[str, float]:
        """Return for each joint +1 if equal angles of it and its image mirror each other, -1 if opposite ones do."""
        pose = zero_pose(self._model, self._joints, standing_pose(self._model))
        return reflected_signs(self._model, pose, self._joints, self.pairs.images, self._base.frame[1])

    @cached_property
    def feet(self) -> tuple[int, ...]:
        """Return for each foot the index of its mirror image, see :func:`.pair_feet`."""
        data = mujoco.MjData(self._model)
        data.qpos[:] = self._standing
        mujoco.mj_kinematics(self._model, data)
        places = np.array([foot_place(self._model, data, self._bodies[foot]) for foot in self._feet])
        return pair_feet(self._feet, places, self._ends, self.pairs.images, self.pairs.plane)

    def image(self, name: str) -> str:
        """Return the name of the same joint or body on the other side, or ``name`` if there is none."""
        images = self.pairs.images
        if name in images:
            return images[name]
        if name in self._feet and self._feet[self.feet[self._feet.index(name)]] != name:
            return self._feet[self.feet[self._feet.index(name)]]
        moved = [joint.name for joint in self._joints if joint.body == name]
        if moved and images[moved[-1]] != moved[-1]:
            return next(joint.body for joint in self._joints if joint.name == images[moved[-1]])
        return name if moved else swap_side(name, self._bodies)

    def actions(self, actuators: Sequence[int], driven: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Return permutation and sign: ``sign * action[..., permutation]`` is the mirrored action. Each ``[A]``.

        An actuator that turns its joint the other way than its image does, for a negative gear, has the other sign. One
        of a joint whose mirror image has none is its own image, which no mirror check passes.

        Args:
            actuators: MuJoCo's indices of the actuators.
            driven: For each actuator the name of the joint that it drives.
        """
        gears = [float(self._model.actuator_gear[i, 0]) for i in actuators]
        order, sign = [], []
        for i, name in enumerate(driven):
            other = self.pairs.images[name]
            k = driven.index(other) if other in driven else i
            order.append(k)
            sign.append(self.signs[name] * (-1.0 if gears[i] * gears[k] < 0 else 1.0))
        return np.array(order, dtype=np.int64), np.array(sign, dtype=np.float64)
