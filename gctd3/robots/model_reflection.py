"""The reflection of a robot's model in its sagittal plane: which joints are images, and the reflection of a state."""

from __future__ import annotations

from functools import cached_property

import mujoco
import numpy as np

from gctd3.robots.mirror_pairs import pair_joints, reflect_axes, zero_pose
from gctd3.robots.mjcf import Joint, base_joints, bodies_below, body_name, colliding_geoms, joint_kind, read_joints
from gctd3.robots.robot import Robot
from gctd3.robots.rotations import rotation_matrix, rotation_quaternion

_ACROSS = 1e-6  # of a unit axis: how far one may be off the lateral axis, or off the sagittal plane
_PLACED = 1e-5  # m, or of the robot's extent where that is more than 1 m


def misplaced_joints(robot: Robot) -> list[str]:
    """Find the joints that are far from the reflections of their images, if the base can leave the sagittal plane.

    Where it cannot, it matters little how far aside a joint is.
    """
    if not {"side", "roll", "yaw"} & set(robot.base.coordinates):
        return []
    misplaced = ModelReflection(robot).misplaced
    return [joint.name for joint in robot.joints if joint.name in misplaced]


class ModelReflection:
    """Reflect the whole state of a robot's model: its base and its joints, driven or not.

    Args:
        robot: The robot.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot, self.model, self.plane = robot, robot.model, robot.mirror_plane
        model, root = robot.model, robot.base.root
        self.root, self.lateral, self.matrix = root, self.plane.lateral, self.plane.matrix
        # All of them: joints that nothing drives move, too.
        inner, standing = read_joints(model, root, robot.path), robot.standing_qpos
        self.joints = [*_base(model, root), *inner]
        last = {leg[-1].name for leg in robot.legs if leg}
        pairs = pair_joints(model, root, inner, standing, self.lateral, last)
        # The task's joints mirror each other as the robot says; the others follow them.
        images = pairs.images | robot.mirror
        placed = pairs.placed
        if len(placed) < len(inner):  # not all poses in which a robot stands are symmetric
            zero = zero_pose(model, inner, standing)
            placed |= pair_joints(model, root, inner, zero, self.lateral, last).placed
        self.misplaced = [joint.name for joint in inner if joint.name not in placed]
        self.by_name = {joint.name: joint for joint in self.joints}
        self.image = {joint.name: images.get(joint.name, joint.name) for joint in self.joints}
        self.data = mujoco.MjData(model)
        self.data.qpos[:] = zero_pose(model, inner, standing)
        mujoco.mj_kinematics(model, self.data)
        axes = reflect_axes(self.data.xaxis[[joint.id for joint in self.joints]], self.joints, self.lateral)
        self.turned = dict(zip(self.image, axes, strict=True))
        self.sign = {
            joint.name: 1.0 if self.turned[joint.name] @ self.data.xaxis[self.partner(joint).id] > 0 else -1.0
            for joint in self.joints
        }
        bodies = bodies_below(model, root)
        extent = np.ptp(
            np.concatenate([self.data.xanchor[[j.id for j in self.joints]], self.data.xpos[bodies]]), axis=0
        )
        self.extent = max(float(extent.max()), 1e-6)

    def partner(self, joint: Joint) -> Joint:
        """Return the mirror image of a joint."""
        return self.by_name[self.image[joint.name]]

    @cached_property
    def flat(self) -> bool:
        """Return whether the robot moves in its sagittal plane only, where it does not matter how far aside parts are.

        Neither its base nor a joint then moves anything across the plane.
        """
        if {"side", "roll", "yaw"} & set(self.robot.base.coordinates):
            return False
        for joint in self.joints:
            along = abs(float(self.data.xaxis[joint.id] @ self.lateral))
            if joint.kind == "ball" or abs(along - (1.0 if joint.kind == "hinge" else 0.0)) > _ACROSS:
                return False
        return True

    def seen(self, vectors: np.ndarray) -> np.ndarray:
        """Return vectors ``[*, 3]`` without their irrelevant part: for a robot in a plane, the part across it."""
        return np.asarray(vectors - (vectors @ self.lateral)[..., None] * self.lateral) if self.flat else vectors

    @property
    def rounding(self) -> float:
        """Return by how much files round the places of parts (m)."""
        return _PLACED * max(1.0, self.extent)

    @cached_property
    def links(self) -> dict[int, int]:
        """Return the mirror image of each moving part, by the index of its topmost body."""
        model, images = self.model, {self.root: self.root}
        for joint in self.joints:
            images[int(model.jnt_bodyid[joint.id])] = int(model.jnt_bodyid[self.partner(joint).id])
        return images

    def foot_geoms(self, foot: str) -> list[int]:
        """Return the indices of a foot's colliding geoms."""
        bodies = {body_name(self.model, b): b for b in bodies_below(self.model, self.root)}
        return colliding_geoms(self.model, bodies[foot])

    def states(self, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Reflect a state: positions ``[nq]`` and velocities ``[nv]``."""
        mirrored, speed = qpos.copy(), qvel.copy()
        for joint in self.joints:
            other, sign = self.partner(joint), self.sign[joint.name]
            q, v, p, w = joint.qpos, joint.qvel, other.qpos, other.qvel
            if joint.kind == "free":
                frame, shift = self._frames[joint.id]
                turn = self.matrix @ rotation_matrix(qpos[q + 3 : q + 7]) @ frame.T
                arm = turn @ shift
                place, spin = self.plane.place(qpos[q : q + 3]), -frame @ qvel[v + 3 : v + 6]
                mirrored[q : q + 3], mirrored[q + 3 : q + 7] = place - arm, rotation_quaternion(turn)
                speed[v + 3 : v + 6] = spin
                speed[v : v + 3] = self.matrix @ qvel[v : v + 3] - _cross(turn @ spin, arm)
            elif joint.kind == "ball":
                frame, _ = self._frames[joint.id]
                mirrored[p : p + 4] = rotation_quaternion(frame @ rotation_matrix(qpos[q : q + 4]) @ frame.T)
                speed[w : w + 3] = -frame @ qvel[v : v + 3]
            else:
                mirrored[p], speed[w] = sign * qpos[q], sign * qvel[v]
        return mirrored, speed

    @cached_property
    def _frames(self) -> dict[int, tuple[np.ndarray, np.ndarray]]:
        """Return for each free joint and ball what maps its body's places onto its image's: rotation and shift."""
        frames, data = {}, self.data
        for joint in self.joints:
            if joint.kind in ("free", "ball"):
                own, image = (int(self.model.jnt_bodyid[j.id]) for j in (joint, self.partner(joint)))
                one, two = (data.xmat[body].reshape(3, 3) for body in (own, image))
                shift = two.T @ (self.plane.place(data.xpos[own]) - data.xpos[image])
                frames[joint.id] = two.T @ self.matrix @ one, shift
        return frames


def _base(model: mujoco.MjModel, root: int) -> list[Joint]:
    """Read the joints of the base, which are their own mirror images."""
    joints = []
    for i in base_joints(model, root):
        limits = tuple(map(float, model.jnt_range[i])) if model.jnt_limited[i] else (-np.inf, np.inf)
        place = int(model.jnt_qposadr[i]), int(model.jnt_dofadr[i])
        name = model.joint(i).name or f"joint_{i}"
        kind, body = joint_kind(model, i), body_name(model, root)
        joints.append(Joint(name, None, body, *place, (limits[0], limits[1]), kind, i))
    return joints


def _cross(one: np.ndarray, two: np.ndarray) -> np.ndarray:
    crossed = np.zeros(3)
    mujoco.mju_cross(crossed, one, two)
    return crossed
