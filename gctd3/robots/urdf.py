"""Read a URDF file for MuJoCo: find its meshes, give it a free base, keep the limits of its joints.

MuJoCo's own reader would fix the base to the world, find no mesh by ``package://``, and make of an effort a limit of
the joint, which slows a saturated servo, instead of one of its servo.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

from gctd3.errors import RobotError, one_line
from gctd3.robots.urdf_meshes import take_meshes
from gctd3.robots.urdf_repair import fix_massless, mend_inertias, skip_floating_root, take_the_rest
from gctd3.robots.urdf_tree import check_tree, first_names, joint_range

_ROOT = re.compile(rb"<\s*([A-Za-z_][\w:.-]*)")


@dataclass(frozen=True)
class URDF:
    """Hold the content of a URDF file.

    Attributes:
        spec: Bodies, joints and colliding geoms, with a free base; no floor and no actuators.
        limits: Each joint's largest torque (``effort``, N m) and velocity (``velocity_limit``, rad/s), by its name.
        notes: One sentence for each thing that was added, changed or left out.
    """

    spec: mujoco.MjSpec
    limits: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def is_urdf(file: Path) -> bool:
    """Tell whether a file is a URDF: by the root of its XML, not by its name."""
    try:
        text = re.sub(rb"<!--.*?-->|<[?!][^>]*>", b"", file.read_bytes()[: 1 << 16], flags=re.DOTALL)
    except OSError:
        return file.suffix == ".urdf"
    root = _ROOT.search(text)
    return root[1] == b"robot" if root else file.suffix == ".urdf"


def read_urdf(file: Path) -> URDF:
    """Read a URDF file.

    Raises:
        RobotError: If it is not one, or one of its colliding meshes is missing or of a format that is not read.
    """
    try:
        root = ElementTree.parse(file).getroot()
    except (OSError, ElementTree.ParseError) as error:
        raise RobotError(f"{file} is not a URDF: {error}") from error
    if any(str(element.tag).startswith("{http") and "xacro" in str(element.tag) for element in root.iter()):
        raise RobotError(f"{file} is a template: make the URDF of it with xacro {file.name} > {file.stem}.urdf.")
    if root.tag != "robot" or root.find("link") is None:
        raise RobotError(f"{file} is not a URDF: it has no <robot> with a <link>.")
    check_tree(root, file)
    if not any(link.find("collision") is not None for link in root.iterfind("link")):
        raise RobotError(f"{file} has no foot: none of its links has a <collision>.")
    notes: list[str] = []
    meshes = take_meshes(root, file, notes)
    mend_inertias(root, file, notes)
    fix_massless(root, file, notes)
    take_the_rest(root, notes)
    skip_floating_root(root)
    try:
        spec = mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding="unicode"))
    except ValueError as error:
        raise RobotError(f"{file} is not a URDF that MuJoCo can read: {one_line(error)}.") from error
    for number, mesh in enumerate(meshes):
        mesh.add(spec, f"collision_{number}")
    for link in root.iterfind("link"):
        if link.find("inertial") is None:
            # Of such a link MuJoCo would make a solid body of water.
            for geom in (spec.body(link.get("name")) or spec.worldbody).geoms:
                geom.mass = 0.0
    _free(spec, root, file, notes)
    limits = _limits(spec, root, notes)
    _exclude_overlaps(spec, file, notes)
    return URDF(spec, limits, tuple(notes))


def _exclude_overlaps(spec: mujoco.MjSpec, file: Path, notes: list[str]) -> None:
    """Let links that overlap where all angles are 0 not collide: their hulls are rounder than they are."""
    try:
        model = spec.compile()
    except ValueError as error:
        raise RobotError(f"{file} is not a URDF that MuJoCo can compile: {one_line(error)}.") from error
    data = mujoco.MjData(model)
    for joint in range(model.njnt):
        if model.jnt_limited[joint]:
            data.qpos[model.jnt_qposadr[joint]] = np.clip(0.0, *model.jnt_range[joint])
    mujoco.mj_forward(model, data)
    touching = {
        tuple(sorted(int(model.geom_bodyid[geom]) for geom in pair)) for pair in data.contact.geom if min(pair) >= 0
    }
    for one, two in sorted(touching):
        spec.add_exclude(bodyname1=model.body(one).name, bodyname2=model.body(two).name)
    if touching:
        pairs = [f"{model.body(one).name} and {model.body(two).name}" for one, two in sorted(touching)]
        notes.append(
            f"Links that overlap where all angles are 0 do not collide with each other: {first_names(pairs, '; ')}."
        )


def _free(spec: mujoco.MjSpec, root: ElementTree.Element, file: Path, notes: list[str]) -> None:
    """Give the root link a free joint."""
    joints = root.findall("joint")
    below = {child.get("link") for joint in joints for child in joint.iterfind("child")}
    tops = [name for link in root.iterfind("link") if (name := link.get("name", "")) not in below]
    if len(tops) != 1:
        raise RobotError(f"{file}: expected one root link, got {len(tops)}: {first_names(tops) if tops else 'none'}.")
    if any(int(joint.type) == mujoco.mjtJoint.mjJNT_FREE for joint in spec.joints):
        return
    bodies = [body for body in spec.worldbody.bodies]
    if len(bodies) != 1:
        raise RobotError(f"{file}: expected one link below the root link {tops[0]!r}, got {len(bodies)}.")
    bodies[0].add_freejoint(name="root")
    notes.append(f"The root link {bodies[0].name!r} moves freely (free joint 'root').")


def _limits(spec: mujoco.MjSpec, root: ElementTree.Element, notes: list[str]) -> dict[str, dict[str, float]]:
    """Take the limits of torque off the joints, for their servos to keep; those of 0 are no limits."""
    by_joint, silent, wide = dict[str, dict[str, float]](), list[str](), list[str]()
    for joint in spec.joints:
        joint.actfrclimited, joint.actfrcrange = mujoco.mjtLimited.mjLIMITED_FALSE, [0.0, 0.0]
    for joint in root.iterfind("joint"):
        if joint.get("type") not in ("revolute", "continuous", "prismatic") or joint.find("mimic") is not None:
            continue
        limit, name = joint.find("limit"), joint.get("name", "")
        attributes = {} if limit is None else limit.attrib
        stated = {"effort": attributes.get("effort"), "velocity_limit": attributes.get("velocity")}
        by_joint[name] = {key: value for key, text in stated.items() if (value := abs(float(text or 0.0))) > 0.0}
        if "effort" not in by_joint[name]:
            silent.append(name)
        low, high = joint_range(joint)
        if limit is not None and low == high and joint.get("type") != "continuous":
            wide.append(name)
    if len(by_joint) > len(silent):
        notes.append("The limits of torque are the servos', not the joints'.")
    if silent:
        notes.append(f"{first_names(silent)} state no limit of torque (effort).")
    if wide:
        notes.append(f"The limits of {first_names(wide)}, lower and upper, are equal: MuJoCo takes them for none.")
    return {name: limits for name, limits in by_joint.items() if limits}
