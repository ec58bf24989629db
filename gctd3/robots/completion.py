"""Completion of a robot's file: parts that walking needs and the file lacks are added, each with a note.

A file that lacks nothing stays as it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from gctd3.errors import RobotError, suggest
from gctd3.robots.carried_load import carried_load, carrying_command
from gctd3.robots.draft import Draft, check_patterns, listed
from gctd3.robots.floating_base import AXES
from gctd3.robots.foot_bodies import foot_geoms, split_feet
from gctd3.robots.ground import (
    add_contact_sensors,
    add_floor,
    add_velocity_sensors,
    can_collide,
    contact_sensors,
    find_floor,
    geoms_of,
    missing_geoms,
    touching_bodies,
)
from gctd3.robots.held_joints import hold_joints
from gctd3.robots.held_pose import holds
from gctd3.robots.home_pose import find_pose
from gctd3.robots.mjcf import base_joints, bodies_below, body_name, driven_joints, joint_name, standing_pose
from gctd3.robots.pose_limits import clipped, lowered
from gctd3.robots.servos import complete_servos, joint_id
from gctd3.robots.stance import below_feet, leg_ends, like_legs, lowest_part, stance

if TYPE_CHECKING:
    from gctd3.robots.servo_settings import ServoSettings
    from gctd3.robots.settings import RobotSettings

FALLS = "Servos that hold the standing pose do not keep the robot from falling:"
_ABOVE, _BELOW = 0.02, -0.005  # m: how far a key's feet may be from the ground


@dataclass(frozen=True)
class Completed:
    """Hold the model of a file with its additions.

    Attributes:
        model: The compiled model.
        spec: The source of the model, which can be changed and compiled again.
        notes: One sentence for each thing that was added or changed.
        held: Angle (rad) of each joint that was fixed, by name.
        root: Name of the robot's root body.
        feet: Names of the bodies that may touch the ground.
    """

    model: mujoco.MjModel
    spec: mujoco.MjSpec
    notes: tuple[str, ...] = ()
    held: Mapping[str, float] = field(default_factory=dict)
    root: str | None = None
    feet: tuple[str, ...] | None = None


def complete(
    spec: mujoco.MjSpec,
    file: Path,
    settings: RobotSettings,
    limits: Mapping[str, ServoSettings] | None = None,
) -> Completed:
    """Add the parts that walking needs and a robot's file lacks: ground, feet, a standing pose, servos, sensors.

    Args:
        spec: The file's content; it is changed in place if it lacks something.
        file: Path of the file, for messages.
        settings: Settings of the robot.
        limits: Limits that the file gives for single joints' servos and MJCF has no place for, by the joint's name.

    Raises:
        RobotError: If the file is no robot, or a setting names something that it does not have.
    """
    before = _prepare(spec)
    draft = Draft(spec, file, settings.root)
    for sentence in before:
        draft.edit(sentence)
    first = draft.model
    _check_places(first, file)
    names, several = [joint_name(first, j) for j in draft.joints()], len(settings.sources) > 1
    check_patterns(settings.servos, names, "robot.servos", file, several)
    floor = _ground(draft)
    pose, key, feet, split = _stand(draft, settings, floor)
    if any(split):
        floor_name = draft.model.geom(floor).name
        names = split_feet(draft, [geoms for geoms in split if geoms])
        renamed = iter(names)
        feet = [next(renamed) if geoms else name for name, geoms in zip(feet, split, strict=True)]
        floor = _geom(draft.model, floor_name)
        draft.edit(
            f"The feet {listed(names)} get bodies of their own, so that the rest of their shanks is another part."
        )
    if pose is None:
        pose = _find(draft, settings, floor, feet)
    settled = draft.model.qpos0 if pose is None else draft.qpos_of(pose)
    if settings.feet is not None:
        _check_feet(draft, feet, settled, floor)
    held = hold_joints(draft, list(settings.hold), draft.pose_of(settled)) if settings.hold else {}
    floor = _geom(draft.model, draft.model.geom(floor).name) if held else floor
    _servos(draft, settings, limits or {}, pose, feet, floor)
    _sense(draft, feet)
    if pose is not None:
        _write_pose(draft, pose, key, feet)
    if not draft.edited:
        _clip_pose(draft)
    if not draft.edited:
        return Completed(first, spec, root=draft.root_name, feet=tuple(feet))
    draft.compile()
    _clip_pose(draft)
    _passive(draft)
    _try(draft, feet, floor)
    return Completed(draft.model, spec, tuple(draft.notes), held, draft.root_name, tuple(feet))


def _check_places(model: mujoco.MjModel, file: Path) -> None:
    """Refuse a file with a part that is nowhere, or farther away than MuJoCo reckons with."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for kind, places in (("body", data.xpos), ("geom", data.geom_xpos)):
        # A comparison with NaN is false.
        away = np.flatnonzero(~(np.abs(places) < mujoco.mjMAXVAL).all(axis=1))
        if len(away):
            part = int(away[0])
            name = getattr(model, kind)(part).name or f"number {part}"
            raise RobotError(f"{file}: {kind} {name} is at {places[part].tolist()} m.")


# Ground.


def _prepare(spec: mujoco.MjSpec) -> list[str]:
    """Add a floor to a file that has nothing of the kind, before it is compiled; return the notes.

    Parts of scenes may lack the very floor that their pairs and sensors name.
    """
    types = mujoco.mjtGeom
    grounds = [g for g in spec.geoms if g.type in (types.mjGEOM_PLANE, types.mjGEOM_HFIELD)]
    if grounds or any(g.type == types.mjGEOM_BOX for g in spec.worldbody.geoms):
        return []
    missing, notes = missing_geoms(spec), list[str]()
    if len(missing) > 1:
        return []
    contype, conaffinity = 1, 1
    if not spec.pairs and not any(g.contype or g.conaffinity for g in spec.geoms):
        # Its scene would name what may touch; by custom these groups are not drawn but for collisions.
        solid = [g for g in spec.geoms if g.group >= 3]
        for geom in solid:
            geom.conaffinity = 1
        conaffinity = 0
        if solid:
            notes.append("No geom of the file can touch anything; those of group 3 and above touch the ground now.")
    else:
        for geom in spec.geoms:
            contype, conaffinity = contype | int(geom.conaffinity), conaffinity | int(geom.contype)
    name = add_floor(spec, missing[0] if missing else "floor", contype, conaffinity)
    return [f"The file has no ground; a level plane {name!r} at z = 0 is added.", *notes]


def _ground(draft: Draft) -> int:
    """Return the index of the floor, which is added if there is none."""
    floor = find_floor(draft.model, draft.root)
    if floor is not None:
        if not draft.model.geom(floor).name:
            element = next(geom for geom in draft.spec.geoms if geom.id == floor)
            element.name = "floor" if "floor" not in {geom.name for geom in draft.spec.geoms} else f"geom_{floor}"
            draft.compile()
        return floor
    model = draft.model
    robot = [geom for body in bodies_below(model, draft.root) for geom in geoms_of(model, body)]
    contype = int(np.bitwise_or.reduce([1, *model.geom_conaffinity[robot]]))
    conaffinity = int(np.bitwise_or.reduce([1, *model.geom_contype[robot]]))
    name = add_floor(draft.spec, contype=contype, conaffinity=conaffinity)
    draft.edit(f"The file has no ground; a level plane {name!r} at z = 0 is added.")
    draft.compile()
    added = _geom(draft.model, name)
    if not touching_bodies(draft.model, draft.root, added):
        raise RobotError(f"{draft.file} has no foot: no geom of the robot can touch the ground.")
    return added


def _geom(model: mujoco.MjModel, name: str) -> int:
    return int(model.geom(name).id)


# Feet and standing pose.


def _stand(
    draft: Draft, settings: RobotSettings, floor: int
) -> tuple[dict[str, np.ndarray] | None, str | None, list[str], list[list[int]]]:
    """Choose the key in which the robot stands, and its feet.

    Returns:
        The pose by the joints' names and the key's name, ``None`` without one; the feet's bodies; and for each the
        geoms that become a body of their own.
    """
    model, root = draft.model, draft.root
    ends = leg_ends(model, root, floor)
    named = _named_feet(draft, settings.feet, floor) if settings.feet is not None else None
    if named is not None:
        ends = list(dict.fromkeys(body for body, _ in named))
    if not ends:
        raise RobotError(f"{draft.file} has no foot: no leg ends in a body with a geom that can touch the ground.")
    chosen = _choose_key(draft, settings.pose, floor, ends, named is not None)
    if chosen is not None:
        key, qpos = chosen
    else:
        key, qpos = None, _reference(draft)
    stood = stance(model, root, floor, qpos, ends)
    feet = ends if named is not None else list(stood.feet)
    if named is None and key is None:
        feet = like_legs(model, root, ends, feet)
    if not feet:
        raise RobotError(
            f"{draft.file}: none of {listed([body_name(model, body) for body in ends])} reaches the ground in the pose "
            "in which the robot stands."
        )
    sensed = contact_sensors(model, root)
    split: list[list[int]] = []
    for body in feet:
        named_geoms = [geom for other, geoms in named or [] if other == body for geom in geoms]
        alone = body_name(model, body) in sensed and not named_geoms
        parts = named_geoms or ([] if alone or named else foot_geoms(model, body, floor, qpos, stood.height))
        split.append(parts)
    names = [body_name(model, body) for body in feet]
    return (None if chosen is None else draft.pose_of(qpos)), key, names, split


def _named_feet(draft: Draft, names: str | Sequence[str], floor: int) -> list[tuple[int, list[int]]]:
    """Return the body of each foot that is named by body, geom or site, and its geoms if it is but a part of it."""
    model = draft.model
    bodies = {body_name(model, b): b for b in bodies_below(model, draft.root)}
    inside = set(bodies.values())
    geoms = {model.geom(g).name: g for g in range(model.ngeom) if int(model.geom_bodyid[g]) in inside}
    sites = {model.site(s).name: s for s in range(model.nsite) if int(model.site_bodyid[s]) in inside}
    feet: list[tuple[int, list[int]]] = []
    for name in [names] if isinstance(names, str) else names:
        if name in bodies:
            feet.append((bodies[name], []))
            continue
        if name not in geoms and name not in sites:
            raise RobotError(
                f"{draft.file} has no body, geom or site {name!r}.{suggest(name, [*bodies, *geoms, *sites])} "
                f"Its bodies are {', '.join(bodies)}."
            )
        body = int(model.geom_bodyid[geoms[name]] if name in geoms else model.site_bodyid[sites[name]])
        able = [g for g in geoms_of(model, body) if can_collide(model, g, floor)]
        if name in geoms:
            part = geoms[name]
        else:
            part = min(able, key=lambda g: float(np.linalg.norm(model.geom_pos[g] - model.site_pos[sites[name]])))
        feet.append((body, [part] if part in able and len(able) > 1 else []))
    if not feet:
        raise RobotError(f"{draft.file}: feet must name at least one body, got none.")
    return feet


def _check_feet(draft: Draft, feet: Sequence[str], qpos: np.ndarray, floor: int) -> None:
    """Raise a :class:`.RobotError` if the robot would stand on other parts than the feet that are named."""
    model = draft.model
    below = below_feet(model, draft.root, floor, qpos, [draft.body_id(name) for name in feet])
    if below is not None:
        raise RobotError(
            f"{draft.file}: the feet {listed(list(feet))} do not reach the ground: in the standing pose "
            f"{body_name(model, below[0])} is {below[1]:.2g} m lower."
        )


def _choose_key(
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


def _reference(draft: Draft) -> np.ndarray:
    return clipped(draft.model, draft.model.qpos0, draft.joints())[0]


def _find(draft: Draft, settings: RobotSettings, floor: int, feet: Sequence[str]) -> dict[str, np.ndarray] | None:
    """Find a standing pose for a robot on a free base, with a note; others stand in their reference pose."""
    model, root = draft.model, draft.root
    base = base_joints(model, root)
    if not len(base) or int(model.jnt_type[base[0]]) != int(mujoco.mjtJoint.mjJNT_FREE):
        return None
    ids = [draft.body_id(name) for name in feet]
    pose = find_pose(model, root, floor, ids, AXES[settings.forward or "x"])
    if pose is None:
        return None
    changed = [j for j in draft.joints() if abs(pose[model.jnt_qposadr[j]] - model.qpos0[model.jnt_qposadr[j]]) > 0.05]
    if not changed:
        return None
    angles = [f"{joint_name(model, j)} {pose[int(model.jnt_qposadr[j])]:.2f}" for j in changed]
    draft.edit(f"The file names no standing pose; one with bent legs is found: {listed(angles, 12)} rad.")
    return draft.pose_of(pose)


def _write_pose(draft: Draft, pose: Mapping[str, np.ndarray], key: str | None, feet: Sequence[str]) -> None:
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


def _clip_pose(draft: Draft) -> None:
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


# Servos and sensors.


def _servos(
    draft: Draft,
    settings: RobotSettings,
    limits: Mapping[str, ServoSettings],
    pose: Mapping[str, np.ndarray] | None,
    feet: Sequence[str],
    floor: int,
) -> None:
    model = draft.model
    qpos = model.qpos0.copy() if pose is None else draft.qpos_of(pose)
    ids = [draft.body_id(name) if name else 0 for name in feet]
    load = carried_load(model, qpos, ids, floor)
    complete_servos(draft, qpos, load, settings.servos, limits)


def _sense(draft: Draft, feet: Sequence[str]) -> None:
    """Add a sensor of ground contact for each part of the robot that can touch the ground and has none."""
    model = draft.model
    floor = find_floor(model, draft.root)
    if floor is None:
        raise RobotError(f"{draft.file} has no ground.")
    known = contact_sensors(model, draft.root)
    able = [body_name(model, body) for body in touching_bodies(model, draft.root, floor)]
    missing = [name for name in dict.fromkeys([*feet, *able]) if name not in known]
    if not missing:
        return
    draft.edit()
    add_contact_sensors(draft.spec, missing, model.geom(floor).name)
    draft.sensed = tuple(missing)
    draft.edit(f"Sensors of contact with {model.geom(floor).name!r} are added: {listed(missing)}.")
    add_velocity_sensors(draft.spec, feet)
    draft.edit(f"Sensors of the feet's velocities are added: {listed(list(feet))}.")


def _passive(draft: Draft) -> None:
    driven = set(driven_joints(draft.model))
    passive = [joint_name(draft.model, j) for j in draft.joints() if j not in driven]
    if passive:
        draft.notes.append(f"Nothing drives {listed(passive)}: they move, but are no nodes and have no action.")


def _try(draft: Draft, feet: Sequence[str], floor: int) -> None:
    """Hold the standing pose for a while; note a fall, servos that are too weak, and shanks on the ground."""
    model, root = draft.model, draft.root
    if model.nu != len(driven_joints(model)) or not len(base_joints(model, root)):
        return
    sensors = {n: a for n, a in contact_sensors(model, root).items() if n not in feet}
    held = holds(model, standing_pose(model), root, list(sensors.values()))
    if held.fell is not None:
        draft.notes.append(f"{FALLS} {held.fell:.2g} s.")
    elif held.weak:
        names = [joint_name(model, j) for j in held.weak]
        draft.notes.append(f"The servos of {listed(names)} need all of their torque to hold the standing pose.")
    resting = [name for name, address in sensors.items() if address in held.touching]
    added = {s.objname: s for s in draft.spec.sensors if s.name == "" and s.objname in draft.sensed}
    gone = [name for name in resting if name in added]
    if held.fell is not None:
        return
    if gone:
        # Soft servos sag; an action of 0 will ask them for what carries the weight.
        ids = [draft.body_id(name) for name in feet]
        command = carrying_command(model, standing_pose(model), ids, floor)
        held = holds(model, standing_pose(model), root, [sensors[name] for name in gone], command=command)
        gone = [name for name in gone if held.fell is not None or sensors[name] in held.touching]
    if gone:
        for name in gone:
            draft.spec.delete(added[name])
        draft.compile()
        draft.notes.append(f"The standing robot rests on {listed(gone)}, too, so that this does not count as a fall.")
