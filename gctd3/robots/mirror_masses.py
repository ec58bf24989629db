"""The masses of moving parts against their mirror images', and a copy of the model in which both sides are equal."""

from __future__ import annotations

import copy

import mujoco
import numpy as np

from gctd3.robots.mirror_messages import millimetres, name_pair
from gctd3.robots.mjcf import body_name
from gctd3.robots.model_reflection import ModelReflection
from gctd3.robots.rotations import rotation_quaternion


class Masses:
    """Compare the masses of the moving parts of a robot with their mirror images'.

    Args:
        image: The reflection of the robot's model.

    Attributes:
        largest: The largest difference, as a part of the robot's mass (and of its extent).
        worst: What it is, in words.
    """

    def __init__(self, image: ModelReflection) -> None:
        self.image, model, data = image, image.model, image.data
        owner = np.array([_owner(image, body) for body in range(model.nbody)])
        self.parts = {link: np.flatnonzero(owner == link) for link in image.links}
        self.lumps = {link: _lump(model, data, bodies) for link, bodies in self.parts.items()}
        whole = max(sum(mass for mass, *_ in self.lumps.values()), 1e-12)
        self.largest, self.worst = 0.0, "the masses"
        for link, other in image.links.items():
            if other < link:
                continue
            (m, c, i), (n, d, k) = self._reflected(link), self.lumps[other]
            name = name_pair(body_name(model, link), body_name(model, other))
            away = float(np.linalg.norm(image.seen(c - d)))
            turned = self._inertia_gap(i, k)
            mean = 0.5 * (m + n)
            off = (
                f"{millimetres(away / 2)} off the middle"
                if link == other
                else f"{millimetres(away)} off its reflection"
            )
            for size, difference in (
                (abs(m - n), f"the mass of body {name}, {m:.4g} kg and {n:.4g} kg"),
                (mean * away / image.extent, f"the centre of mass of body {name}, {off}"),
                (turned / image.extent**2, f"the inertia of body {name}, {turned:.2g} kg m^2 off its reflection"),
            ):
                if size / whole > self.largest:
                    self.largest, self.worst = size / whole, difference

    def _reflected(self, link: int) -> tuple[float, np.ndarray, np.ndarray]:
        mass, centre, inertia = self.lumps[link]
        return mass, self.image.plane.place(centre), self.image.matrix @ inertia @ self.image.matrix

    def _inertia_gap(self, one: np.ndarray, two: np.ndarray) -> float:
        gap, lateral = one - two, self.image.lateral
        return float(abs(lateral @ gap @ lateral)) if self.image.flat else float(np.linalg.norm(gap))

    def equalised(self) -> mujoco.MjModel:
        """Return a copy of the model in which both sides have the means of their masses and of what follows."""
        image, model = self.image, copy.copy(self.image.model)
        for joint in image.joints:
            pair = [joint.dofs, image.partner(joint).dofs]
            model.dof_armature[pair[0]] = image.model.dof_armature[pair].mean(axis=0)
        actuators = np.array(image.robot.actuators, dtype=np.int64)
        damping = image.model.actuator_biasprm[actuators, 2]
        model.actuator_biasprm[actuators, 2] = (damping + damping[image.robot.action_mirror[0]]) / 2
        for link, other in image.links.items():
            (m, c, i), (n, d, k) = self.lumps[link], self._reflected(other)
            mass, centre, inertia = (m + n) / 2, (c + d) / 2, (i + k) / 2
            turn = image.data.xmat[link].reshape(3, 3)
            moments, axes = np.linalg.eigh(turn.T @ inertia @ turn)
            axes[:, 0] *= np.sign(np.linalg.det(axes))
            bodies = self.parts[link]
            model.body_mass[bodies], model.body_inertia[bodies] = 0.0, 0.0
            model.body_mass[link], model.body_inertia[link] = mass, np.maximum(moments, 0.0)
            model.body_ipos[link] = turn.T @ (centre - image.data.xpos[link])
            model.body_iquat[link] = rotation_quaternion(axes)
            model.body_sameframe[link] = 0  # its inertia no longer has the body's own frame
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model


def _owner(image: ModelReflection, body: int) -> int:
    """Return the moving part that a body belongs to; -1 for the world's and other scenery."""
    while body and body not in image.links:
        body = int(image.model.body_parentid[body])
    return body if body else -1


def _lump(model: mujoco.MjModel, data: mujoco.MjData, bodies: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Compute mass (kg), centre of mass (m) and inertia about it (kg m^2) of bodies that move as one, in the world."""
    masses = model.body_mass[bodies]
    mass = float(masses.sum())
    if mass <= 0:
        return 0.0, data.xpos[bodies[0]].copy(), np.zeros((3, 3))
    centre = masses @ data.xipos[bodies] / mass
    inertia = np.zeros((3, 3))
    for body, own in zip(bodies, masses, strict=True):
        turn, arm = data.ximat[body].reshape(3, 3), data.xipos[body] - centre
        inertia += turn @ np.diag(model.body_inertia[body]) @ turn.T
        inertia += own * (float(arm @ arm) * np.eye(3) - np.outer(arm, arm))
    return mass, np.asarray(centre), inertia
