"""Reading an MJCF: where it is, and what of it makes a legged robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import mujoco
import numpy as np

from gctd3.errors import RobotError


@dataclass(frozen=True)
class Joint:
    """One moving joint of the robot, outside its base.

    Attributes:
        name: The joint's name in the MJCF.
        parent: Name of the next joint towards the root, or ``None`` if the root body comes first.
        body: Name of the body that the joint moves.
        qpos: Index of its angle (rad) in ``qpos``.
        qvel: Index of its angular velocity (rad/s) in ``qvel``.
        range: Lower and upper limit (rad), infinite where the MJCF sets none.
    """

    name: str
    parent: str | None
    body: str
    qpos: int
    qvel: int
    range: tuple[float, float]


def find_mjcf(path: str | Path) -> Path:
    """The MJCF file of a robot given by path or by the name of one that ships with the library.

    Raises:
        RobotError: If there is neither such a file nor such a robot.
    """
    file = Path(path)
    if file.suffix == ".xml":
        if not file.is_file():
            raise RobotError(f"No MJCF file at {file}.")
        return file
    models = Path(str(resources.files("gctd3.models")))
    shipped = sorted(p.parent.name for p in models.glob("*/*.xml") if p.stem == p.parent.name)
    if str(path) not in shipped:
        raise RobotError(f"No robot {str(path)!r}: give a path to an .xml file, or one of {', '.join(shipped)}.")
    return models / str(path) / f"{path}.xml"


def root_body(model: mujoco.MjModel, file: Path) -> int:
    """Index of the one body under the world that has joints.

    Raises:
        RobotError: If there is none, or more than one.
    """
    roots = [b for b in range(1, model.nbody) if model.body_parentid[b] == 0 and model.body_jntnum[b] > 0]
    if len(roots) != 1:
        names = ", ".join(model.body(b).name or "(unnamed)" for b in roots) or "none"
        raise RobotError(f"{file}: expected one root body with joints under the world, got {len(roots)}: {names}.")
    return roots[0]


def read_joints(model: mujoco.MjModel, root: int, file: Path) -> list[Joint]:
    """All joints below the body ``root``, in the MJCF's order.

    Raises:
        RobotError: If there is none, or one is not a named hinge.
    """
    joints: list[Joint] = []
    last_on_body: dict[int, str] = {}
    for i in range(model.njnt):
        body = int(model.jnt_bodyid[i])
        if body == root:
            continue
        name = model.joint(i).name
        if model.jnt_type[i] != mujoco.mjtJoint.mjJNT_HINGE or not name:
            raise RobotError(f"{file}: joint {name or i!r} of body {model.body(body).name!r} must be a named hinge.")
        above = body
        while above and above not in last_on_body:
            above = int(model.body_parentid[above])
        limited = bool(model.jnt_limited[i])
        low, high = (float(v) for v in model.jnt_range[i]) if limited else (-np.inf, np.inf)
        joints.append(
            Joint(
                name=name,
                parent=last_on_body.get(above),
                body=model.body(body).name,
                qpos=int(model.jnt_qposadr[i]),
                qvel=int(model.jnt_dofadr[i]),
                range=(low, high),
            )
        )
        last_on_body[body] = name
    if not joints:
        raise RobotError(f"{file} has no joint below its root body {model.body(root).name!r}.")
    return joints


def read_actuated(model: mujoco.MjModel, joints: Sequence[Joint], file: Path) -> list[str]:
    """The joint that each actuator drives.

    Raises:
        RobotError: If an actuator is not a position servo with a range on one of ``joints``.
    """
    names = {j.name for j in joints}
    actuated = []
    for i in range(model.nu):
        actuator = model.actuator(i).name or str(i)
        if model.actuator_trntype[i] != mujoco.mjtTrn.mjTRN_JOINT:
            raise RobotError(f"{file}: actuator {actuator!r} does not drive a joint.")
        joint = model.joint(int(model.actuator_trnid[i, 0])).name
        if joint not in names:
            raise RobotError(f"{file}: actuator {actuator!r} drives {joint!r}, which is not a joint below the root.")
        if model.actuator_biastype[i] != mujoco.mjtBias.mjBIAS_AFFINE or model.actuator_biasprm[i, 1] >= 0:
            raise RobotError(f"{file}: actuator {actuator!r} must be a <position> servo: actions are desired angles.")
        if not model.actuator_ctrllimited[i]:
            raise RobotError(f"{file}: actuator {actuator!r} needs a ctrlrange (rad), onto which actions are mapped.")
        actuated.append(joint)
    return actuated


def leaf_bodies(model: mujoco.MjModel, root: int) -> list[str]:
    """Names of the bodies below ``root`` that end a chain and can collide: feet, unless told otherwise."""
    parents = {int(p) for p in model.body_parentid[1:]}
    colliding = {int(model.geom_bodyid[g]) for g in range(model.ngeom) if model.geom_contype[g]}
    return [model.body(b).name for b in range(root + 1, model.nbody) if b not in parents and b in colliding]
