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

from gctd3.errors import RobotError
from gctd3.robots.added_ground import complete_ground, geom_index, prepare_ground
from gctd3.robots.carried_load import carried_load
from gctd3.robots.chosen_feet import check_feet, choose_feet
from gctd3.robots.clearance import placed, sole
from gctd3.robots.draft import Draft, check_patterns, listed
from gctd3.robots.floating_base import AXES
from gctd3.robots.foot_bodies import split_feet
from gctd3.robots.ground import (
    add_contact_sensors,
    add_velocity_sensors,
    contact_sensors,
    find_floor,
    touching_bodies,
)
from gctd3.robots.held_joints import hold_joints
from gctd3.robots.home_pose import find_pose
from gctd3.robots.mjcf import base_joints, body_name, driven_joints, joint_name
from gctd3.robots.servos import complete_servos
from gctd3.robots.stand_trial import try_standing
from gctd3.robots.standing_key import clip_key, write_key

if TYPE_CHECKING:
    from gctd3.robots.servo_settings import ServoSettings
    from gctd3.robots.settings import RobotSettings

# Parts of the simulation without which nothing walks, by their flag in <option>, and what is missing without each.
NEEDED = {
    "constraint": (mujoco.mjtDisableBit.mjDSBL_CONSTRAINT, "nothing holds its feet on the ground"),
    "contact": (mujoco.mjtDisableBit.mjDSBL_CONTACT, "its feet fall through the ground"),
    "actuation": (mujoco.mjtDisableBit.mjDSBL_ACTUATION, "its servos have no torque"),
    "gravity": (mujoco.mjtDisableBit.mjDSBL_GRAVITY, "nothing presses its feet onto the ground"),
}
LEAST_GRAVITY = 0.1  # m/s^2 downward, a sixteenth of the Moon's
TOUCHES = 1e-3  # thickness of the sole whose velocity is a foot's: what touches the ground slides on it (m)


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
    before = prepare_ground(spec)
    draft = Draft(spec, file, settings.root)
    for sentence in before:
        draft.edit(sentence)
    first = draft.model
    _check_simulation(first, file)
    _check_places(first, file)
    _contacts(draft, settings)
    names, several = [joint_name(first, j) for j in draft.joints()], len(settings.sources) > 1
    check_patterns(settings.given_servos, names, "robot.servos", file, several)
    floor = complete_ground(draft)
    pose, key, feet, split = choose_feet(draft, settings, floor)
    if any(split):
        floor_name = draft.model.geom(floor).name
        names = split_feet(draft, [geoms for geoms in split if geoms])
        renamed = iter(names)
        feet = [next(renamed) if geoms else name for name, geoms in zip(feet, split, strict=True)]
        floor = geom_index(draft.model, floor_name)
        draft.edit(
            f"The feet {listed(names)} get bodies of their own, so that the rest of their shanks is another part."
        )
    if pose is None:
        pose = _find(draft, settings, floor, feet)
    settled = draft.model.qpos0 if pose is None else draft.qpos_of(pose)
    if settings.feet is not None:
        check_feet(draft, feet, settled, floor)
    held = hold_joints(draft, list(settings.hold), draft.pose_of(settled)) if settings.hold else {}
    floor = geom_index(draft.model, draft.model.geom(floor).name) if held else floor
    _servos(draft, settings, limits or {}, pose, feet, floor)
    _sense(draft, feet, pose)
    if pose is not None:
        write_key(draft, pose, key, feet)
    if not draft.edited:
        clip_key(draft)
    if not draft.edited:
        return Completed(first, spec, root=draft.root_name, feet=tuple(feet))
    draft.compile()
    clip_key(draft)
    _passive(draft)
    try_standing(draft, feet, floor)
    return Completed(draft.model, spec, tuple(draft.notes), held, draft.root_name, tuple(feet))


def _check_simulation(model: mujoco.MjModel, file: Path) -> None:
    """Refuse a file that turns off what walking needs of the simulation."""
    for flag, (bit, without) in NEEDED.items():
        if model.opt.disableflags & bit:
            raise RobotError(f'{file}: <flag {flag}="disable"/> in its <option> must go: {without}.')
    if model.opt.gravity[2] > -LEAST_GRAVITY:
        raise RobotError(
            f"{file}: gravity must point down, with z of -{LEAST_GRAVITY:g} m/s^2 or less, got "
            f"{model.opt.gravity.tolist()}."
        )


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


def _contacts(draft: Draft, settings: RobotSettings) -> None:
    """Give contacts the friction cone and the ratio of impedances that settings ask for, with a note."""
    option, changes = draft.spec.option, []
    cones = {"pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL, "elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC}
    if settings.cone is not None and int(option.cone) != int(cones[settings.cone]):
        option.cone = cones[settings.cone]
        changes.append(f"friction cones are {settings.cone}")
    if settings.impratio is not None and option.impratio != settings.impratio:
        option.impratio = settings.impratio
        changes.append(f"impratio is {settings.impratio:g}")
    if changes:
        draft.edit(f"Contacts as the settings ask for: {', '.join(changes)}.")


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
    complete_servos(draft, qpos, load, settings.given_servos, limits)


def _sense(draft: Draft, feet: Sequence[str], pose: Mapping[str, np.ndarray] | None) -> None:
    """Add a sensor of ground contact for each part of the robot that can touch the ground and has none.

    The velocities of the feet are those of their soles: a foot may be the end of a shank, whose origin is the knee.
    """
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
    data = placed(model, model.qpos0 if pose is None else draft.qpos_of(pose))
    soles = {}
    for name in feet:
        body = draft.body_id(name)
        place = sole(model, data, body, floor, TOUCHES) - data.xpos[body]
        soles[name] = np.asarray(place @ data.xmat[body].reshape(3, 3))
    add_velocity_sensors(draft.spec, soles)
    draft.edit(f"Sensors of the feet's velocities are added: {listed(list(feet))}.")


def _passive(draft: Draft) -> None:
    driven = set(driven_joints(draft.model))
    passive = [joint_name(draft.model, j) for j in draft.joints() if j not in driven]
    if passive:
        draft.notes.append(f"Nothing drives {listed(passive)}: they move, but are no nodes and have no action.")
