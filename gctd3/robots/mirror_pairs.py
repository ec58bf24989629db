"""Mirror images of joints: reflection in the sagittal plane, read from names, else from geometry.

The sagittal plane holds the vertical and the forward axis. A hinge's axis is a pseudo-vector: its component across the
plane survives the reflection, the other two turn round. A slide's axis is a vector: only the one across turns round.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence

import mujoco
import numpy as np

from gctd3.robots.mjcf import Joint, standing_pose

_SIDES = (("right", "left"), ("Right", "Left"), ("R", "L"), ("r", "l"))
_NEAR = 0.02  # of the robot's extent: how far a reflected joint may lie from its partner


def swap_side(name: str, known: Collection[str]) -> str:
    """Return ``name`` with its side exchanged, dropped or added, if that is one of ``known``; else ``name``.

    ``hip_right`` and ``hip_left`` are a pair, and so are ``thigh`` and ``thigh_left``, ``rfemur`` and ``lfemur``.
    """
    for right, left in _SIDES:
        for side, other in ((right, left), (left, right)):
            swapped = re.sub(rf"(?<![a-zA-Z]){side}(?![a-zA-Z])", other, name)
            if swapped != name and swapped in known:
                return swapped
    glued = {"r": "l", "l": "r", "R": "L", "L": "R"}.get(name[:1], name[:1]) + name[1:]
    if glued != name and glued in known:
        return glued
    plain = without_side(name)
    if plain != name:
        return plain if plain in known else name
    sided = [other for other in known if other != name and without_side(other) == name]
    return sided[0] if len(sided) == 1 else name


def without_side(name: str) -> str:
    """Return ``name`` without the word ``right`` or ``left``."""
    return re.sub(r"(?i)_(right|left)(?![a-z])|(?<![a-z])(right|left)_", "", name)


def pair_joints(
    model: mujoco.MjModel, joints: Sequence[Joint], last: Collection[str], lateral: np.ndarray
) -> dict[str, str]:
    """Pair each joint with its mirror image, else itself: an involution that maps the kinematic tree onto itself.

    Args:
        model: The model.
        joints: The robot's joints.
        last: Names of the joints that a foot hangs on.
        lateral: Unit vector across the sagittal plane, shape ``[3]``.
    """
    names = {joint.name for joint in joints}
    pairs = {name: name for name in names}
    for joint in joints:
        other = swap_side(joint.name, names)
        if pairs[joint.name] == joint.name and pairs[other] == other:
            pairs[joint.name], pairs[other] = other, joint.name
    for name, other in _pairs_by_place(model, joints, lateral).items():
        if pairs[name] == name and pairs[other] == other:
            pairs[name], pairs[other] = other, name
    return _consistent({joint.name: joint for joint in joints}, pairs, last)


def count_reflected(model: mujoco.MjModel, joints: Sequence[Joint], lateral: np.ndarray) -> int:
    """Count the joints in the plane across ``lateral`` or with a reflected partner, a measure of symmetry."""
    return len(_pairs_by_place(model, joints, lateral))


def reflected_sign(model: mujoco.MjModel, joint: Joint, partner: Joint, lateral: np.ndarray) -> float:
    """Return +1 if equal angles of the two joints mirror each other, -1 if opposite ones do."""
    _, axes = _places(model, model.qpos0)
    return 1.0 if float(_reflect_axis(axes[joint.id], joint, lateral) @ axes[partner.id]) > 0.0 else -1.0


def unreflected(
    model: mujoco.MjModel, joints: Sequence[Joint], pairs: Mapping[str, str], lateral: np.ndarray
) -> list[str]:
    """Find the joints whose reflection differs from their mirror image in place or axis; return their names.

    The plane passes through the mean place of the paired joints, or of all joints if none are paired.

    Args:
        model: The model.
        joints: The robot's joints.
        pairs: Every joint's mirror image, see :func:`pair_joints`.
        lateral: Unit vector across the sagittal plane, shape ``[3]``.
    """
    # Mirrored angles are equal or opposite ones, so that it is angles of zero that must be symmetric.
    zero = model.qpos0.copy()
    zero[[joint.qpos for joint in joints if joint.kind != "ball"]] = 0.0
    places, axes = _places(model, zero)
    ids = {joint.name: joint.id for joint in joints}
    paired = [ids[name] for name, other in pairs.items() if other != name] or list(ids.values())
    centre, near, unmatched = places[paired].mean(axis=0), _near(places, joints), []
    for joint in joints:
        other = ids[pairs[joint.name]]
        away = float(np.linalg.norm(_reflect_place(places[joint.id], centre, lateral) - places[other]))
        if away > near or not _along(_reflect_axis(axes[joint.id], joint, lateral), axes[other], joint):
            unmatched.append(joint.name)
    return unmatched


def _pairs_by_place(model: mujoco.MjModel, joints: Sequence[Joint], lateral: np.ndarray) -> dict[str, str]:
    places, axes = _places(model, standing_pose(model))
    centre = places[[joint.id for joint in joints]].mean(axis=0)
    near, pairs = _near(places, joints), {}
    for joint in joints:
        reflected = _reflect_place(places[joint.id], centre, lateral)
        axis = _reflect_axis(axes[joint.id], joint, lateral)
        ranked = sorted(
            (float(np.linalg.norm(places[other.id] - reflected)), k)
            for k, other in enumerate(joints)
            if other.kind == joint.kind and _along(axis, axes[other.id], joint)
        )
        if ranked and ranked[0][0] <= near:
            pairs[joint.name] = joints[ranked[0][1]].name
    return {name: other for name, other in pairs.items() if pairs.get(other) == name}


def _places(model: mujoco.MjModel, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return anchors (m) and axes of all joints in a pose, each ``[njnt, 3]``."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    return data.xanchor.copy(), data.xaxis.copy()


def _near(places: np.ndarray, joints: Sequence[Joint]) -> float:
    """Return how far a reflected joint may lie from its image (m): a part of the robot's extent, not the scene's."""
    return _NEAR * max(float(np.ptp(places[[joint.id for joint in joints]], axis=0).max()), 1e-6)


def _reflect_place(place: np.ndarray, centre: np.ndarray, lateral: np.ndarray) -> np.ndarray:
    return np.asarray(place - 2.0 * float((place - centre) @ lateral) * lateral)


def _along(axis: np.ndarray, other: np.ndarray, joint: Joint) -> bool:
    """Tell whether two axes are parallel; true for a ball, which has no axis."""
    return joint.kind == "ball" or abs(float(axis @ other)) > 0.99


def _reflect_axis(axis: np.ndarray, joint: Joint, lateral: np.ndarray) -> np.ndarray:
    reflected = axis - 2.0 * float(axis @ lateral) * lateral
    return reflected if joint.kind == "slide" else -reflected


def _consistent(joints: Mapping[str, Joint], pairs: dict[str, str], last: Collection[str]) -> dict[str, str]:
    """Remove the ``pairs`` that do not map the tree onto itself; each round but the last removes at least one."""

    def part(name: str | None) -> None:
        if name is not None:
            other = pairs[name]
            pairs[name], pairs[other] = name, other

    while True:
        before = dict(pairs)
        for name, joint in joints.items():
            other = joints[pairs[name]]
            fits = other.kind == joint.kind and (name in last) == (other.name in last)
            above = pairs[joint.parent] if joint.parent is not None else None
            if other.name != name and not (fits and other.parent == above):
                part(name)
            elif other.name == name and above != joint.parent:
                part(joint.parent)
        if pairs == before:
            return pairs
