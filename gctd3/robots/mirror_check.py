"""Whether a robot may be mirrored: decided by its dynamics.

The mirror image of a transition is a transition of the robot if to reflect and then to step is to step and then to
reflect. :func:`check_mirror` decides that in three stages, and names the part that fails.

1. What a file says in so many words has to mirror exactly, to 1e-6: the joints' ranges, damping and friction, and their
   actuators' gears, gains and limits. A joint whose partner turns the other way, or whose actuator has a negative gear,
   has its numbers mirrored with the sign; that is only another convention. Where joints are may differ by what files
   round away, 0.01 mm and 1e-4 rad; rotors by 1 % of a joint's inertia, and the servos' damping, which the compiler may
   have derived from a damping ratio and from masses, by 1 %.
2. Masses need not be equal, since no real robot's are (a trunk's centre of mass lies millimetres off the middle), nor
   need meshes of feet. What such differences may amount to is measured where it counts, in the motion: from 100 random
   states with random actions, over one control step, in the air and on the ground, the two orders of stepping and
   reflecting are compared. Their difference is divided by the motion, which is the change of velocities in that step;
   both are measured in the norm of kinetic energy, so that it matters neither which coordinates, which units nor which
   masses a robot has. This is the residual; it may be at most :data:`MOST_RESIDUAL`.
3. In the air, where nothing but masses may differ, masses have to explain the residual: of a copy of the model whose
   masses, centres of mass and inertias are the means of both sides', it must vanish, up to :data:`MOST_UNEXPLAINED` for
   what is rounded away, and for steps of finite length of a base whose frame is not in the middle.
   So any other difference, a tendon or a closed loop on one side, does not pass unnoticed.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from gctd3.robots.geometry import geom_points
from gctd3.robots.ground import ground_height
from gctd3.robots.mirror_pairs import line_distance, pair_joints, reflect_axes, zero_pose
from gctd3.robots.mjcf import Joint, base_joints, bodies_below, body_name, colliding_geoms, joint_kind, read_joints
from gctd3.robots.robot import Robot

STATES = 100  # compared in the air, and as many on the ground
MOST_RESIDUAL = 0.05  # of the motion of one step: less than what policies are trained to bear by randomised masses
MOST_UNEXPLAINED = 0.01  # of the motion, with the masses of both sides made equal
_EXACT = 1e-6  # of a number, or of a unit where it is below 1
_ROUNDED = 1e-4  # rad, of axes
_DERIVED = 0.01  # of a number that is derived from masses
_PLACED = 1e-5  # m, or of the robot's extent where that is more than 1 m
_ALIKE = 1e-9  # of the robot's mass or extent: masses that need no copy in which they are equal
_DEPTH = 0.001  # m: how deep the lowest foot is in the ground
_DRAWS = 6  # of a state on the ground, ever nearer to standing, until no parts lie in one another
# What decides how feet touch, besides their shapes.
_TOUCH = {
    "friction": ("friction", "condim", "priority"),
    "softness": ("solref", "solimp", "solmix", "margin", "gap"),
    "collision mask": ("contype", "conaffinity"),
}
_SIZES = {"free": 6, "ball": 3}  # degrees of freedom


@dataclass(frozen=True)
class MirrorCheck:
    """Represent the verdict on a robot's mirror.

    Attributes:
        symmetric: Whether mirrored transitions are transitions of the robot.
        residual: Difference between stepping and reflecting in one order and the other, as a part of the motion of one
            step; NaN if it was not measured, since something else is not the same.
        reason: What is not the same on the left and the right, with the part's name and numbers; empty if nothing is.
    """

    symmetric: bool
    residual: float
    reason: str = ""

    def __str__(self) -> str:
        """Return a line that says whether the robot is mirrored, and why."""
        if not self.symmetric:
            return f"mirror: off, for {self.reason}"
        if not self.reason:
            return "mirror: on, the left and the right are equal"
        return f"mirror: on, residual {_percent(self.residual)} of the motion of one step, explained by {self.reason}"


def check_mirror(robot: Robot, control_dt: float) -> MirrorCheck:
    """Decide whether a robot may be mirrored, see the module's description; once for each robot and period.

    Args:
        robot: The robot.
        control_dt: Control period (s).
    """
    if control_dt not in robot.mirror_checks:
        robot.mirror_checks[control_dt] = _check(robot, control_dt)
    return robot.mirror_checks[control_dt]


def _check(robot: Robot, control_dt: float) -> MirrorCheck:
    balls = [joint.name for joint in robot.joints if joint.kind == "ball"]
    if balls:
        return MirrorCheck(False, np.nan, f"joint {balls[0]!r}: a ball's rotation has no reflection among the features")
    image = ModelReflection(robot)
    reason = next(image.differences(), None)
    if reason is not None:
        return MirrorCheck(False, np.nan, reason)
    masses, shapes = image.masses(), image.shapes()
    steps = max(round(control_dt / robot.model.opt.timestep), 1)
    air = image.residual(robot.model, steps, ground=None)
    unexplained = air
    if air.total > MOST_UNEXPLAINED:
        unexplained = image.residual(masses.equalised(), steps, ground=None, states=STATES // 10)
    if unexplained.total > MOST_UNEXPLAINED:
        return MirrorCheck(False, unexplained.total, image.blame(unexplained))
    residual, ground = air, ground_height(robot.model)
    if ground is not None:
        landed = image.residual(robot.model, steps, ground)
        residual = max(air, landed, key=lambda measured: measured.total)
    if residual.total > MOST_RESIDUAL:
        difference = masses.worst if air.total > MOST_RESIDUAL else shapes or "what touches the ground"
        return MirrorCheck(
            False,
            residual.total,
            f"{difference}: the mirror image differs by {_percent(residual.total)} of the motion of one step, at most "
            f"{_percent(MOST_RESIDUAL)} may be",
        )
    reasons = [masses.worst if masses.largest > _ALIKE else "", shapes]
    return MirrorCheck(True, residual.total, "; ".join(reason for reason in reasons if reason))


def misplaced_joints(robot: Robot) -> list[str]:
    """Find the joints that are far from the reflections of their images, if the base can leave the sagittal plane.

    Where it cannot, it matters little how far aside a joint is.
    """
    if not {"side", "roll", "yaw"} & set(robot.base.coordinates):
        return []
    misplaced = ModelReflection(robot).misplaced
    return [joint.name for joint in robot.joints if joint.name in misplaced]


@dataclass(frozen=True)
class Residual:
    """Hold how far stepping and reflecting differ by their order.

    Attributes:
        total: As a part of the motion of one step.
        parts: The same of each degree of freedom alone, shape ``[nv]``.
    """

    total: float
    parts: np.ndarray


class ModelReflection:
    """Reflect the whole state of a robot's model: its base, its joints, driven or not, and its controls.

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
            if joint.kind == "ball" or abs(along - (1.0 if joint.kind == "hinge" else 0.0)) > _EXACT:
                return False
        return True

    def seen(self, vectors: np.ndarray) -> np.ndarray:
        """Return vectors ``[*, 3]`` without their irrelevant part: for a robot in a plane, the part across it."""
        return np.asarray(vectors - (vectors @ self.lateral)[..., None] * self.lateral) if self.flat else vectors

    # What has to mirror exactly.

    def differences(self) -> Iterator[str]:
        """Name what does not mirror exactly: joints, their actuators, and how feet touch."""
        for joint in self.joints:
            other = self.partner(joint)
            yield from self._place(joint, other)
            yield from self._numbers(joint, other)
        yield from self._actuators()
        yield from self._contacts()

    def _place(self, joint: Joint, other: Joint) -> Iterator[str]:
        data = self.data
        off = float(np.linalg.norm(np.cross(self.turned[joint.name], data.xaxis[other.id])))
        if joint.kind in ("hinge", "slide") and off > _ROUNDED:
            turn = np.degrees(np.arcsin(min(off, 1.0)))
            yield f"joint {_both(joint, other)}: the reflected axis is {turn:.2g} degrees off"
        if joint.name in self.misplaced and joint is other and not self.flat:
            yield f"joint {joint.name!r}: it is beside the middle, and no joint is at its reflected place"
        if self.robot.base.free is None and joint.name not in self.robot.mirror and joint.body == self.robot.root:
            return  # a base may be hung up anywhere
        gap = self.seen(self.plane.place(data.xanchor[joint.id]) - data.xanchor[other.id])
        away = float(line_distance(gap[None], data.xaxis[other.id][None], [joint.kind])[0])
        if joint.kind != "free" and away > _PLACED * max(1.0, self.extent):
            yield f"joint {_both(joint, other)}: the reflected anchor is {_mm(away)} off"

    def _numbers(self, joint: Joint, other: Joint) -> Iterator[str]:
        """Compare numbers of two joints: those that turn round with the joint, and those that do not."""
        model, sign, where = self.model, self.sign[joint.name], f"joint {_both(joint, other)}"
        size = _SIZES.get(joint.kind, 1)
        dofs, images = slice(joint.qvel, joint.qvel + size), slice(other.qvel, other.qvel + size)
        single = size == 1
        for name, field in (("range", "jnt_range"), ("limit of its actuators' force", "jnt_actfrcrange")):
            limited = getattr(model, {"jnt_range": "jnt_limited", "jnt_actfrcrange": "jnt_actfrclimited"}[field])
            one, two = getattr(model, field)[joint.id], getattr(model, field)[other.id]
            if limited[joint.id] != limited[other.id]:
                yield f"{where}: only one has a {name}"
            elif limited[joint.id] and single and not _same(_turned(one, sign), two):
                yield f"{where}: {name} {_numbers(one)} is not the mirror image of {_numbers(two)}"
        sprung = single and np.abs(model.jnt_stiffness[joint.id]).max() > 0
        if sprung and not _same(sign * model.qpos_spring[joint.qpos], model.qpos_spring[other.qpos]):
            yield f"{where}: the spring's rest is not mirrored"
        for name, field in (("stiffness", "jnt_stiffness"), ("margin", "jnt_margin")):
            one, two = getattr(model, field)[joint.id], getattr(model, field)[other.id]
            # Of a rotor it counts how much of the joint's whole inertia it is.
            enough = _DERIVED * model.dof_M0[dofs] if name == "armature" else _EXACT * np.maximum(np.abs(two), 1.0)
            if (np.abs(one - two) > enough).any():
                yield f"{where}: {name} {_numbers(one)} is not {_numbers(two)}"
        for name in ("damping", "armature", "frictionloss"):
            one, two = (getattr(model, f"dof_{name}")[of] for of in (dofs, images))
            # Of a rotor it counts how much of the joint's whole inertia it is.
            enough = _DERIVED * model.dof_M0[dofs] if name == "armature" else _EXACT * np.maximum(np.abs(two), 1.0)
            if (np.abs(one - two) > enough).any():
                yield f"{where}: {name} {_numbers(one)} is not {_numbers(two)}"

    def _actuators(self) -> Iterator[str]:
        robot, model = self.robot, self.model
        order, signs = robot.action_mirror
        centre, scale = robot.action_map
        for k, name in enumerate(robot.actuated):
            other = robot.mirror[name]
            if other not in robot.actuated:
                yield f"joint {name!r}: it has an actuator, its mirror image {other!r} has none"
                continue
            i, j, sign = robot.actuators[k], robot.actuators[order[k]], signs[k]
            where = f"actuator {_named(robot.action_names[k], robot.action_names[order[k]])}"
            kinds = [
                (model.actuator_dyntype[a], model.actuator_gaintype[a], model.actuator_biastype[a]) for a in (i, j)
            ]
            if kinds[0] != kinds[1]:
                yield f"{where}: they are of different kinds"
            for field, one, two in (
                ("gear", np.abs(model.actuator_gear[i]), np.abs(model.actuator_gear[j])),
                ("gain", model.actuator_gainprm[i], model.actuator_gainprm[j]),
                ("stiffness", model.actuator_biasprm[i, 1:2], model.actuator_biasprm[j, 1:2]),
                ("bias", sign * model.actuator_biasprm[i, :1], model.actuator_biasprm[j, :1]),
                ("dynamics", model.actuator_dynprm[i], model.actuator_dynprm[j]),
            ):
                if not _same(one, two):
                    yield f"{where}: {field} {_numbers(one)} is not {_numbers(two)}"
            one, two = model.actuator_biasprm[i, 2:], model.actuator_biasprm[j, 2:]
            if not np.allclose(one, two, rtol=_DERIVED, atol=_EXACT):
                yield f"{where}: damping {_numbers(one)} is not {_numbers(two)}"
            for field in ("force", "ctrl"):
                limited, limits = (getattr(model, f"actuator_{field}{end}") for end in ("limited", "range"))
                one, two = _turned(limits[i], sign), limits[j]
                if limited[i] != limited[j]:
                    yield f"{where}: only one has a {field}range"
                elif limited[i] and not _same(one, two):
                    yield f"{where}: {field}range {_numbers(limits[i])} is not the mirror image of {_numbers(two)}"
            if not _same(sign * centre[k], centre[order[k]]):
                yield f"{where}: an action of 0 asks for {centre[k]:.4g} rad and {centre[order[k]]:.4g} rad"
            if not _same(scale[k], scale[order[k]]):
                yield f"{where}: an action of 1 changes the angle by {scale[k]:.4g} rad and {scale[order[k]]:.4g} rad"

    def _contacts(self) -> Iterator[str]:
        """Compare the friction and the softness of feet; their outlines come later."""
        robot, model = self.robot, self.model
        for i, k in enumerate(robot.mirror_feet):
            foot_geoms, image_geoms = (self._geoms(robot.feet[foot]) for foot in (i, k))
            for name, fields in _TOUCH.items():
                one, two = ([_row(model, geom, fields) for geom in geoms] for geoms in (foot_geoms, image_geoms))
                if k > i and not (len(one) == len(two) and all(map(_same, sorted(one), sorted(two)))):
                    yield f"foot {_named(robot.feet[i], robot.feet[k])}: their {name} is not the same"

    # What may differ a little.

    @cached_property
    def links(self) -> dict[int, int]:
        """Return the mirror image of each moving part, by the index of its topmost body."""
        model, images = self.model, {self.root: self.root}
        for joint in self.joints:
            images[int(model.jnt_bodyid[joint.id])] = int(model.jnt_bodyid[self.partner(joint).id])
        return images

    def masses(self) -> Masses:
        """Compare masses, centres of mass and inertias of all moving parts."""
        return Masses(self)

    def shapes(self) -> str:
        """Name the foot whose outline differs most from its image's; empty if none does."""
        robot, order = self.robot, self.robot.mirror_feet
        worst, difference = _PLACED * max(1.0, self.extent), ""
        for i, k in enumerate(order):
            if k < i:
                continue
            points = [self._points(self._geoms(robot.feet[foot])) for foot in (i, k)]
            if not all(map(len, points)):
                continue
            directions = self.seen(_DIRECTIONS)
            one, two = (self.plane.place(points[0]) @ directions.T).max(axis=0), (points[1] @ directions.T).max(axis=0)
            away = float(np.abs(one - two).max())
            if away > worst:
                worst, difference = away, f"the outline of foot {_named(robot.feet[i], robot.feet[k])}, {_mm(away)} off"
        return difference

    def _points(self, geoms: Sequence[int]) -> np.ndarray:
        clouds = [geom_points(self.model, self.data, geom) for geom in geoms]
        return np.concatenate(clouds) if clouds else np.zeros((0, 3))

    def blame(self, residual: Residual) -> str:
        """Name the joint whose motion differs most."""
        dof = int(residual.parts.argmax())
        joint = next(j for j in reversed(self.joints) if j.qvel <= dof)
        return (
            f"joint {_both(joint, self.partner(joint))}: something beside masses that acts on it is not the same, for "
            f"its mirror image moves otherwise by {_percent(residual.total)} of the motion of one step"
        )

    # The motion.

    def states(self, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Reflect a state: positions ``[nq]`` and velocities ``[nv]``."""
        mirrored, speed = qpos.copy(), qvel.copy()
        for joint in self.joints:
            other, sign = self.partner(joint), self.sign[joint.name]
            q, v, p, w = joint.qpos, joint.qvel, other.qpos, other.qvel
            if joint.kind == "free":
                frame, shift = self._frames[joint.id]
                turn = self.matrix @ _matrix(qpos[q + 3 : q + 7]) @ frame.T
                arm = turn @ shift
                place, spin = self.plane.place(qpos[q : q + 3]), -frame @ qvel[v + 3 : v + 6]
                mirrored[q : q + 3], mirrored[q + 3 : q + 7] = place - arm, _quaternion(turn)
                speed[v + 3 : v + 6] = spin
                speed[v : v + 3] = self.matrix @ qvel[v : v + 3] - _cross(turn @ spin, arm)
            elif joint.kind == "ball":
                frame, _ = self._frames[joint.id]
                mirrored[p : p + 4] = _quaternion(frame @ _matrix(qpos[q : q + 4]) @ frame.T)
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

    def residual(self, model: mujoco.MjModel, steps: int, ground: float | None, states: int = STATES) -> Residual:
        """Compare reflecting before and after a control step, from random states.

        Args:
            model: The robot's model, or one with other masses.
            steps: Physics steps in a control step.
            ground: Height of the ground that the robot stands on (m); ``None`` for the air.
            states: Number of random states.
        """
        rng, data, robot = np.random.default_rng(0), mujoco.MjData(model), self.robot
        enabled = model.opt.disableflags
        order, signs = robot.action_mirror
        centre, scale = robot.action_map
        dofs = [d for j in self.joints for d in range(j.qvel, j.qvel + _SIZES.get(j.kind, 1))]
        apart, motion, inertia = 0.0, 0.0, np.zeros((model.nv, model.nv))
        parts = np.zeros((2, model.nv))

        def step(qpos: np.ndarray, qvel: np.ndarray, action: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            mujoco.mj_resetData(model, data)
            data.qpos[:], data.qvel[:] = qpos, qvel
            data.ctrl[list(robot.actuators)] = centre + scale * action
            mujoco.mj_step(model, data, nstep=steps)
            return data.qpos.copy(), data.qvel.copy()

        try:
            if ground is None:
                model.opt.disableflags = int(enabled) | int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
            for _ in range(states):
                qpos, qvel = self._draw(rng, ground)
                action = rng.uniform(-1.0, 1.0, len(robot.actuated))
                begun, speed = self.states(qpos, qvel)
                _, first = step(begun, speed, signs * action[order])
                _, second = self.states(*step(qpos, qvel, action))
                gap, change = np.zeros(model.nv), np.zeros(model.nv)
                gap[dofs], change[dofs] = (first - second)[dofs], (second - speed)[dofs]
                data.qpos[:] = begun
                mujoco.mj_kinematics(model, data)
                mujoco.mj_comPos(model, data)
                mujoco.mj_crb(model, data)
                mujoco.mj_fullM(model, data, inertia)
                apart += float(gap @ inertia @ gap)
                motion += float(change @ inertia @ change)
                parts += np.diag(inertia) * np.stack([gap, change]) ** 2
        finally:
            model.opt.disableflags = enabled
        return Residual(float(np.sqrt(apart / max(motion, 1e-300))), np.sqrt(parts[0] / max(motion, 1e-300)))

    def _draw(self, rng: np.random.Generator, ground: float | None) -> tuple[np.ndarray, np.ndarray]:
        """Draw a state about the standing pose; on the ground its lowest foot just touches."""
        if ground is None:
            return self._near_standing(rng, 1.0)
        size, data, height = 0.5, self._scratch, self.robot.base.height
        for _ in range(_DRAWS):
            qpos, qvel = self._near_standing(rng, size)
            data.qpos[:] = qpos
            mujoco.mj_kinematics(self.model, data)
            low = [points[:, 2].min() for g in self._feet if len(points := geom_points(self.model, data, g))]
            if low and height is not None:
                qpos[height.qpos] -= height.sign * (min(low) - ground + _DEPTH)
                data.qpos[:] = qpos
                mujoco.mj_kinematics(self.model, data)
            # Parts that lie in one another, which no motion leads to, are thrown apart in a direction of no meaning.
            mujoco.mj_collision(self.model, data)
            if not data.ncon or data.contact.dist[: data.ncon].min() > -2.0 * _DEPTH:
                break
            size *= 0.5
        return qpos, qvel

    def _near_standing(self, rng: np.random.Generator, size: float) -> tuple[np.ndarray, np.ndarray]:
        qpos, qvel = self.robot.standing_qpos.copy(), np.zeros(self.model.nv)
        for joint in self.joints:
            q, v = joint.qpos, joint.qvel
            if joint.kind == "free":
                qpos[q : q + 2] += rng.uniform(-1.0, 1.0, 2)
                mujoco.mju_quatIntegrate(qpos[q + 3 : q + 7], size * rng.uniform(-0.4, 0.4, 3), 1.0)
                qvel[v : v + 6] = size * rng.normal(size=6)
            elif joint.kind == "ball":
                mujoco.mju_quatIntegrate(qpos[q : q + 4], size * rng.uniform(-0.1, 0.1, 3), 1.0)
                qvel[v : v + 3] = size * rng.normal(size=3)
            else:
                reach = 0.1 * self.extent if joint.kind == "slide" else 0.4
                drawn = qpos[q] + size * rng.uniform(-reach, reach)
                qpos[q], qvel[v] = min(max(drawn, joint.range[0]), joint.range[1]), size * 5.0 * reach * rng.normal()
        return qpos, qvel

    @cached_property
    def _scratch(self) -> mujoco.MjData:
        return mujoco.MjData(self.model)

    @cached_property
    def _feet(self) -> list[int]:
        return [geom for foot in self.robot.feet for geom in self._geoms(foot)]

    def _geoms(self, foot: str) -> list[int]:
        bodies = {body_name(self.model, b): b for b in bodies_below(self.model, self.root)}
        return colliding_geoms(self.model, bodies[foot])


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
            name = _named(body_name(model, link), body_name(model, other))
            away = float(np.linalg.norm(image.seen(c - d)))
            turned = self._inertia_gap(i, k)
            mean = 0.5 * (m + n)
            off = f"{_mm(away / 2)} off the middle" if link == other else f"{_mm(away)} off its reflection"
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
            pair = [[j.qvel + d for d in range(_SIZES.get(j.kind, 1))] for j in (joint, image.partner(joint))]
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
            model.body_iquat[link] = _quaternion(axes)
            model.body_sameframe[link] = 0  # its inertia no longer has the body's own frame
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model


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


def _matrix(quaternion: np.ndarray) -> np.ndarray:
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, quaternion / np.linalg.norm(quaternion))
    return turn.reshape(3, 3)


def _quaternion(turn: np.ndarray) -> np.ndarray:
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(turn).reshape(9))
    return quaternion


def _cross(one: np.ndarray, two: np.ndarray) -> np.ndarray:
    crossed = np.zeros(3)
    mujoco.mju_cross(crossed, one, two)
    return crossed


def _row(model: mujoco.MjModel, geom: int, fields: Sequence[str]) -> list[float]:
    """Return some fields of a geom, one after the other."""
    return [float(value) for field in fields for value in np.ravel(getattr(model, f"geom_{field}")[geom])]


def _turned(limits: np.ndarray, sign: float) -> np.ndarray:
    """Return limits of a value whose sign may change."""
    return np.asarray(limits if sign > 0 else -limits[::-1])


def _same(one: np.ndarray | Sequence[float] | float, two: np.ndarray | Sequence[float] | float) -> bool:
    return bool(np.allclose(one, two, rtol=_EXACT, atol=_EXACT))


def _both(joint: Joint, other: Joint) -> str:
    return _named(joint.name, other.name)


def _named(one: str, two: str) -> str:
    return f"{one!r}" if one == two else f"{one!r} and its mirror image {two!r}"


def _numbers(values: np.ndarray) -> str:
    numbers = np.trim_zeros(np.ravel(values), "b")
    return " ".join(f"{value:.6g}" for value in numbers) or "0"


def _percent(part: float) -> str:
    return f"{100 * part:.2g} %" if part < 0.1 else f"{100 * part:.0f} %"


def _mm(metres: float) -> str:
    return f"{1000 * metres:.3g} mm"


_CORNERS = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z) != (0, 0, 0)])
_DIRECTIONS = _CORNERS / np.linalg.norm(_CORNERS, axis=1, keepdims=True)
