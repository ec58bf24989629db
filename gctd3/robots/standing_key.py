"""The key of a file in which the robot stands: its choice, its correction, and how the pose is written into it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gctd3.errors import RobotError, suggest
from gctd3.robots.draft import Draft, listed
from gctd3.robots.mjcf import base_joints, body_name, joint_name
from gctd3.robots.pose_limits import clipped, lowered
from gctd3.robots.servos import joint_id
from gctd3.robots.stance import like_legs, lowest_part, stance

_ABOVE, _BELOW = 0.02, -0.005  # m: how far a key's feet may be from the ground


def choose_key(
    draft: Draft, chosen: str | None, floor: int, ends: Sequence[int], all_stand: bool
) -> tuple[str, np.ndarray] | None:
    """Return name and pose of the key in which the robot stands; ``None`` if there is none."""
    model, root = draft.model, draft.root
    keys = {model.key(k).name or f"key_{k}": k for k in reversed(range(model.nkey))}
    if chosen is not None and chosen in draft.dropped:
        raise RobotError(f"{draft.file}: the robot cannot stand in key {chosen!r}: {draft.dropped[chosen]}.")
    if chosen is not None and chosen not in keys:
        raise RobotError(
            f"{draft.file} has no key {chosen!r}.{suggest(chosen, keys)} Its keys are {', '.join(keys) or 'none'}."
        )
    order = sorted(keys.items(), key=lambda item: (item[0] != "stand", item[0] != "home", item[1]))
    passed: list[str] = []
    for name, index in order if chosen is None else [(chosen, keys[chosen])]:
        qpos = model.key_qpos[index].copy()
        reason = _why_not(draft, name, qpos, floor, ends, all_stand)
        if reason is not None and chosen is not None:
            raise RobotError(f"{draft.file}: the robot does not stand in key {name!r}: {reason}.")
        if reason is not None:
            passed.append(f"Key {name!r} is passed over: {reason}.")
            continue
        qpos = _corrected(draft, qpos, floor, ends, f"key {name!r}")
        for sentence in passed:
            draft.edit(sentence)
        return name, qpos
    for sentence in passed:
        if not sentence.startswith("Key 'key_") and model.jnt_type[base_joints(model, root)[0:1]].tolist() == [0]:
            draft.edit(sentence)
    return None


def _why_not(draft: Draft, name: str, qpos: np.ndarray, floor: int, ends: Sequence[int], all_stand: bool) -> str | None:
    """Return why a robot does not stand in a pose; ``None`` if it does."""
    model, root = draft.model, draft.root
    if name in draft.short:
        return "it has not one number for each coordinate"
    stood = stance(model, root, floor, qpos, ends)
    if not stood.upright:
        return "the robot is not upright in it"
    wanted = ends if all_stand else like_legs(model, root, ends, stood.feet)
    missing = [body_name(model, body) for body in wanted if body not in stood.feet]
    if missing:
        return f"{listed(missing)} would not touch the ground"
    lowest = lowest_part(model, root, floor, qpos, stood.feet)
    if lowest is not None:
        return f"{body_name(model, lowest)} would touch the ground"
    return None


def _corrected(draft: Draft, qpos: np.ndarray, floor: int, ends: Sequence[int], what: str) -> np.ndarray:
    """Return a pose with its joints in their ranges and its feet on the ground, with notes on the changes."""
    model, root = draft.model, draft.root
    moved, outside = clipped(model, qpos, draft.joints())
    for joint in outside:
        place = int(model.jnt_qposadr[joint])
        draft.edit(
            f"In {what} the angle of {joint_name(model, joint)} is {moved[place]:.4g} rad instead of "
            f"{qpos[place]:.4g}, which is outside of its range."
        )
    lift = stance(model, root, floor, moved, ends).lift
    off = not _BELOW <= lift <= _ABOVE
    if off or outside:
        put = lowered(model, root, moved, lift)
        if off and not np.array_equal(put, moved):
            draft.edit(
                f"In {what} the robot is {'lowered' if lift > 0 else 'raised'} by {abs(lift):.3g} m to the ground."
            )
        moved = put
    return moved


def write_key(draft: Draft, pose: Mapping[str, np.ndarray], key: str | None, feet: Sequence[str]) -> None:
    """Write the standing pose into the file's keys such that it is the one that is found, if it is not."""
    model = draft.model
    moved = draft.qpos_of(pose)
    names = [model.key(k).name for k in range(model.nkey)]
    first = next((name for name in ("stand", "home") if name in names), None)
    if key == first and key is not None:
        index = names.index(key)
        if np.array_equal(model.key_qpos[index], moved):
            return
        element = draft.spec.keys[index]
        draft.edit()
    else:
        draft.edit(f"The robot stands in key {key!r}." if key is not None else None)
        for other in draft.spec.keys:
            if other.name == "stand":
                other.name = "stand_of_file"
        element = draft.spec.add_key(name="stand")
    element.qpos = moved
    places = [int(model.jnt_qposadr[joint_id(model, a.target)]) for a in draft.spec.actuators]
    element.ctrl = moved[places]
    element.act = []


def clip_key(draft: Draft) -> None:
    """Put a standing pose that the file names into the ranges of the servos, with a note."""
    model = draft.model
    names = [model.key(k).name for k in range(model.nkey)]
    name = next((name for name in ("stand", "home") if name in names), None)
    if name is None:
        return
    index = names.index(name)
    qpos = model.key_qpos[index].copy()
    moved, outside = clipped(model, qpos, draft.joints())
    for joint in outside:
        place = int(model.jnt_qposadr[joint])
        draft.edit(
            f"In the standing pose the angle of {joint_name(model, joint)} is {moved[place]:.4g} rad instead of "
            f"{qpos[place]:.4g}, which is outside of its servo's range."
        )
    if outside:
        draft.spec.keys[index].qpos = moved
        model.key_qpos[index] = moved
