"""Random states of a robot about its standing pose, in the air or with a foot on the ground."""

from __future__ import annotations

import mujoco
import numpy as np

from gctd3.robots.geometry import geom_points
from gctd3.robots.model_reflection import ModelReflection

_DEPTH = 0.001  # m: how deep the lowest foot is in the ground
_DRAWS = 6  # of a state on the ground, ever nearer to standing, until no parts lie in one another


class RandomStates:
    """Draw random states of all joints of a robot's model.

    Args:
        image: The reflection of the robot's model, which knows its joints.
    """

    def __init__(self, image: ModelReflection) -> None:
        self.image, self._data = image, mujoco.MjData(image.model)
        self._feet = [geom for foot in image.robot.feet for geom in image.foot_geoms(foot)]

    def draw(self, rng: np.random.Generator, ground: float | None) -> tuple[np.ndarray, np.ndarray]:
        """Draw a state about the standing pose: positions ``[nq]`` and velocities ``[nv]``.

        Args:
            rng: Source of randomness.
            ground: Height of the ground that the lowest foot just touches (m); ``None`` for the air.
        """
        if ground is None:
            return self._near_standing(rng, 1.0)
        size, model, data, height = 0.5, self.image.model, self._data, self.image.robot.base.height
        for _ in range(_DRAWS):
            qpos, qvel = self._near_standing(rng, size)
            data.qpos[:] = qpos
            mujoco.mj_kinematics(model, data)
            low = [points[:, 2].min() for g in self._feet if len(points := geom_points(model, data, g))]
            if low and height is not None:
                qpos[height.qpos] -= height.sign * (min(low) - ground + _DEPTH)
                data.qpos[:] = qpos
                mujoco.mj_kinematics(model, data)
            # Parts that lie in one another, which no motion leads to, are thrown apart in a direction of no meaning.
            mujoco.mj_collision(model, data)
            if not data.ncon or data.contact.dist[: data.ncon].min() > -2.0 * _DEPTH:
                break
            size *= 0.5
        return qpos, qvel

    def _near_standing(self, rng: np.random.Generator, size: float) -> tuple[np.ndarray, np.ndarray]:
        qpos, qvel = self.image.robot.standing_qpos.copy(), np.zeros(self.image.model.nv)
        for joint in self.image.joints:
            q, v = joint.qpos, joint.qvel
            if joint.kind == "free":
                qpos[q : q + 2] += rng.uniform(-1.0, 1.0, 2)
                mujoco.mju_quatIntegrate(qpos[q + 3 : q + 7], size * rng.uniform(-0.4, 0.4, 3), 1.0)
                qvel[v : v + 6] = size * rng.normal(size=6)
            elif joint.kind == "ball":
                mujoco.mju_quatIntegrate(qpos[q : q + 4], size * rng.uniform(-0.1, 0.1, 3), 1.0)
                qvel[v : v + 3] = size * rng.normal(size=3)
            else:
                reach = 0.1 * self.image.extent if joint.kind == "slide" else 0.4
                drawn = qpos[q] + size * rng.uniform(-reach, reach)
                qpos[q], qvel[v] = min(max(drawn, joint.range[0]), joint.range[1]), size * 5.0 * reach * rng.normal()
        return qpos, qvel
