"""What of a robot has to mirror exactly: the places and numbers of its joints, its actuators, and how its feet touch.

These are numbers that a file states in so many words; what may differ a little is measured elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import mujoco
import numpy as np

from gctd3.robots.mirror_messages import joint_pair, millimetres, name_pair
from gctd3.robots.mirror_pairs import line_distance
from gctd3.robots.mjcf import Joint
from gctd3.robots.model_reflection import ModelReflection

_EXACT = 1e-6  # of a number, or of a unit where it is below 1
_ROUNDED = 1e-4  # rad, of axes
_DERIVED = 0.01  # of a number that is derived from masses
# What decides how feet touch, besides their shapes.
_TOUCH = {
    "friction": ("friction", "condim", "priority"),
    "softness": ("solref", "solimp", "solmix", "margin", "gap"),
    "collision mask": ("contype", "conaffinity"),
}


def exact_differences(image: ModelReflection) -> Iterator[str]:
    """Name what does not mirror exactly: joints, their actuators, and how feet touch."""
    for joint in image.joints:
        other = image.partner(joint)
        yield from _place(image, joint, other)
        yield from _joint_numbers(image, joint, other)
    yield from _actuators(image)
    yield from _contacts(image)


def _place(image: ModelReflection, joint: Joint, other: Joint) -> Iterator[str]:
    data = image.data
    off = float(np.linalg.norm(np.cross(image.turned[joint.name], data.xaxis[other.id])))
    if joint.kind in ("hinge", "slide") and off > _ROUNDED:
        turn = np.degrees(np.arcsin(min(off, 1.0)))
        yield f"joint {joint_pair(joint, other)}: the reflected axis is {turn:.2g} degrees off"
    if joint.name in image.misplaced and joint is other and not image.flat:
        yield f"joint {joint.name!r}: it is beside the middle, and no joint is at its reflected place"
    if image.robot.base.free is None and joint.name not in image.robot.mirror and joint.body == image.robot.root:
        return  # a base may be hung up anywhere
    gap = image.seen(image.plane.place(data.xanchor[joint.id]) - data.xanchor[other.id])
    away = float(line_distance(gap[None], data.xaxis[other.id][None], [joint.kind])[0])
    if joint.kind != "free" and away > image.rounding:
        yield f"joint {joint_pair(joint, other)}: the reflected anchor is {millimetres(away)} off"


def _joint_numbers(image: ModelReflection, joint: Joint, other: Joint) -> Iterator[str]:
    """Compare numbers of two joints: those that turn round with the joint, and those that do not."""
    model, sign, where = image.model, image.sign[joint.name], f"joint {joint_pair(joint, other)}"
    dofs, images = joint.dofs, other.dofs
    single = len(dofs) == 1
    for name, field in (("range", "jnt_range"), ("limit of its actuators' force", "jnt_actfrcrange")):
        limited = getattr(model, {"jnt_range": "jnt_limited", "jnt_actfrcrange": "jnt_actfrclimited"}[field])
        one, two = getattr(model, field)[joint.id], getattr(model, field)[other.id]
        if limited[joint.id] != limited[other.id]:
            yield f"{where}: only one has a {name}"
        elif limited[joint.id] and single and not _same(_turned(one, sign), two):
            yield f"{where}: {name} {_listed(one)} is not the mirror image of {_listed(two)}"
    sprung = single and np.abs(model.jnt_stiffness[joint.id]).max() > 0
    if sprung and not _same(sign * model.qpos_spring[joint.qpos], model.qpos_spring[other.qpos]):
        yield f"{where}: the spring's rest is not mirrored"
    for name, field in (("stiffness", "jnt_stiffness"), ("margin", "jnt_margin")):
        one, two = getattr(model, field)[joint.id], getattr(model, field)[other.id]
        if (np.abs(one - two) > _EXACT * np.maximum(np.abs(two), 1.0)).any():
            yield f"{where}: {name} {_listed(one)} is not {_listed(two)}"
    for name in ("damping", "armature", "frictionloss"):
        one, two = (getattr(model, f"dof_{name}")[of] for of in (dofs, images))
        # Of a rotor it counts how much of the joint's whole inertia it is.
        enough = _DERIVED * model.dof_M0[dofs] if name == "armature" else _EXACT * np.maximum(np.abs(two), 1.0)
        if (np.abs(one - two) > enough).any():
            yield f"{where}: {name} {_listed(one)} is not {_listed(two)}"


def _actuators(image: ModelReflection) -> Iterator[str]:
    robot, model = image.robot, image.model
    order, signs = robot.action_mirror
    centre, scale = robot.action_map
    for k, name in enumerate(robot.actuated):
        other = robot.mirror[name]
        if other not in robot.actuated:
            yield f"joint {name!r}: it has an actuator, its mirror image {other!r} has none"
            continue
        i, j, sign = robot.actuators[k], robot.actuators[order[k]], signs[k]
        where = f"actuator {name_pair(robot.action_names[k], robot.action_names[order[k]])}"
        kinds = [(model.actuator_dyntype[a], model.actuator_gaintype[a], model.actuator_biastype[a]) for a in (i, j)]
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
                yield f"{where}: {field} {_listed(one)} is not {_listed(two)}"
        one, two = model.actuator_biasprm[i, 2:], model.actuator_biasprm[j, 2:]
        if not np.allclose(one, two, rtol=_DERIVED, atol=_EXACT):
            yield f"{where}: damping {_listed(one)} is not {_listed(two)}"
        for field in ("force", "ctrl"):
            limited, limits = (getattr(model, f"actuator_{field}{end}") for end in ("limited", "range"))
            one, two = _turned(limits[i], sign), limits[j]
            if limited[i] != limited[j]:
                yield f"{where}: only one has a {field}range"
            elif limited[i] and not _same(one, two):
                yield f"{where}: {field}range {_listed(limits[i])} is not the mirror image of {_listed(two)}"
        if not _same(sign * centre[k], centre[order[k]]):
            yield f"{where}: an action of 0 asks for {centre[k]:.4g} rad and {centre[order[k]]:.4g} rad"
        if not _same(scale[k], scale[order[k]]):
            yield f"{where}: an action of 1 changes the angle by {scale[k]:.4g} rad and {scale[order[k]]:.4g} rad"


def _contacts(image: ModelReflection) -> Iterator[str]:
    """Compare the friction and the softness of feet; their outlines come later."""
    robot, model = image.robot, image.model
    for i, k in enumerate(robot.mirror_feet):
        foot_geoms, image_geoms = (image.foot_geoms(robot.feet[foot]) for foot in (i, k))
        for name, fields in _TOUCH.items():
            one, two = ([_row(model, geom, fields) for geom in geoms] for geoms in (foot_geoms, image_geoms))
            if k > i and not (len(one) == len(two) and all(map(_same, sorted(one), sorted(two)))):
                yield f"foot {name_pair(robot.feet[i], robot.feet[k])}: their {name} is not the same"


def _row(model: mujoco.MjModel, geom: int, fields: Sequence[str]) -> list[float]:
    """Return some fields of a geom, one after the other."""
    return [float(value) for field in fields for value in np.ravel(getattr(model, f"geom_{field}")[geom])]


def _turned(limits: np.ndarray, sign: float) -> np.ndarray:
    """Return limits of a value whose sign may change."""
    return np.asarray(limits if sign > 0 else -limits[::-1])


def _same(one: np.ndarray | Sequence[float] | float, two: np.ndarray | Sequence[float] | float) -> bool:
    return bool(np.allclose(one, two, rtol=_EXACT, atol=_EXACT))


def _listed(values: np.ndarray) -> str:
    numbers = np.trim_zeros(np.ravel(values), "b")
    return " ".join(f"{value:.6g}" for value in numbers) or "0"
