"""Reading of MJCF files: location, root body, joints, geoms and poses of a legged robot. Walking is checked later."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np

from gctd3.errors import RobotError, one_line, suggest

Kind = Literal["hinge", "slide", "ball", "free"]


@functools.cache
def _kinds() -> dict[int, Kind]:
    """Return the names of MuJoCo's kinds of joints. A function, so that MuJoCo is not needed to import this."""
    return {
        int(mujoco.mjtJoint.mjJNT_HINGE): "hinge",
        int(mujoco.mjtJoint.mjJNT_SLIDE): "slide",
        int(mujoco.mjtJoint.mjJNT_BALL): "ball",
        int(mujoco.mjtJoint.mjJNT_FREE): "free",
    }


@dataclass(frozen=True)
class Joint:
    """Represent a moving joint of the robot, outside its base.

    Attributes:
        name: The joint's name in the MJCF, or ``joint_<id>`` if it has none.
        parent: Name of the next joint towards the root, or ``None`` if the root body comes first.
        body: Name of the body that the joint moves.
        qpos: Index in ``qpos`` of its angle (rad), of a slide's length (m) or of a ball's quaternion.
        qvel: Index in ``qvel`` of its velocity (rad/s; m/s for a slide).
        range: Lower and upper limit (rad or m), infinite where the MJCF sets none.
        kind: ``hinge``, ``slide`` or ``ball``.
        id: MuJoCo's index of the joint.
    """

    name: str
    parent: str | None
    body: str
    qpos: int
    qvel: int
    range: tuple[float, float]
    kind: Kind = "hinge"
    id: int = -1

    @property
    def dofs(self) -> list[int]:
        """Return the indices in ``qvel`` of its degrees of freedom."""
        return [self.qvel + k for k in range({"free": 6, "ball": 3}.get(self.kind, 1))]


def find_mjcf(path: str | Path) -> Path:
    """Find the MJCF file of a robot given by path or by the name of one that ships with the library.

    Raises:
        RobotError: If there is neither such a file nor such a robot.
    """
    file = Path(path)
    if file.suffix == ".xml":
        if not file.is_file():
            raise RobotError(f"No MJCF file at {file}.")
        return file
    shipped = shipped_robots()
    if str(path) not in shipped:
        option = resources.files("gctd3.conf").joinpath("robot", f"{path}.yaml").is_file()
        known = f" robot={path} is for the commands, with settings and without a file." if option else ""
        raise RobotError(
            f"No robot {str(path)!r}.{known or suggest(path, shipped)} "
            f"Give a path to an .xml or .urdf file, or one of {', '.join(shipped)}."
        )
    return shipped[str(path)]


def shipped_robots() -> dict[str, Path]:
    """Return the files of the robots that ship with the library, by name."""
    models = Path(str(resources.files("gctd3.models")))
    return {p.stem: p for p in sorted(models.glob("*/*.xml")) if p.stem == p.parent.name}


def load_mjcf(source: str | Path | mujoco.MjModel | mujoco.MjSpec) -> tuple[mujoco.MjModel, Path]:
    """Load the compiled model of a file, a shipped robot or a model in memory, with its label for messages.

    Raises:
        RobotError: If there is no such file, or MuJoCo cannot compile it, or the source is something else.
    """
    if not isinstance(source, (str, Path, mujoco.MjModel, mujoco.MjSpec)):
        raise RobotError(
            "A robot is the path of an MJCF file, the name of one that ships with the library, a mujoco.MjModel or a "
            f"mujoco.MjSpec, got {source!r} of type {type(source).__name__}."
        )
    if isinstance(source, mujoco.MjModel):
        name = bytes(source.names).split(b"\0", 1)[0].decode()
        return source, Path(f"<{name or 'a model'} in memory>")
    file = Path(f"<{source.modelname} in memory>") if isinstance(source, mujoco.MjSpec) else find_mjcf(source)
    try:
        if isinstance(source, mujoco.MjSpec):
            return source.compile(), file
        model = mujoco.MjModel.from_xml_path(str(file))
        bytes(model.names).decode()
        return model, file
    except UnicodeDecodeError as error:
        raise RobotError(f"{file} has a name that is not UTF-8: {error}") from error
    except ValueError as error:
        raise RobotError(f"{file} is not an MJCF that MuJoCo can compile: {one_line(error)}") from error


def body_name(model: mujoco.MjModel, body: int) -> str:
    """Return a body's name, or ``body_<id>`` if it has none."""
    return model.body(body).name or f"body_{body}"


def joint_name(model: mujoco.MjModel, joint: int) -> str:
    """Return a joint's name, or ``joint_<id>`` if it has none."""
    return model.joint(joint).name or f"joint_{joint}"


def joint_kind(model: mujoco.MjModel, joint: int) -> Kind:
    """Return the kind of a joint: ``hinge``, ``slide``, ``ball`` or ``free``."""
    return _kinds()[int(model.jnt_type[joint])]


def bodies_below(model: mujoco.MjModel, root: int) -> list[int]:
    """Return the indices of ``root`` and of all its descendants."""
    inside = {root}
    for body in range(root + 1, model.nbody):  # parents come before their children
        if int(model.body_parentid[body]) in inside:
            inside.add(body)
    return sorted(inside)


def root_body(model: mujoco.MjModel, file: Path, name: str | None = None) -> int:
    """Return the index of the robot's root: the one body under the world with joints on it or below it.

    Beside a robot, a body with one free joint and no other joint, such as a ball, is scenery.

    Args:
        model: The model.
        file: Path of the MJCF, for messages.
        name: Name of the root, for a file with several robots; the others are then scenery, too.

    Raises:
        RobotError: If no body qualifies, or more than one and none is named.
    """
    trees = [b for b in range(1, model.nbody) if model.body_parentid[b] == 0]
    joints = {b: sum(int(model.body_jntnum[c]) for c in bodies_below(model, b)) for b in trees}
    moving = [b for b in trees if joints[b] > 0]
    articulated = [b for b in moving if joints[b] > 1 or not _floats(model, b)]
    roots = articulated or moving
    known = {body_name(model, b): b for b in roots}
    if name is not None:
        if name not in known:
            raise RobotError(
                f"{file} has no root body {name!r} with joints under the world.{suggest(name, known)} "
                f"It has {', '.join(known) or 'none'}."
            )
        return known[name]
    if len(roots) != 1:
        names = ", ".join(model.body(b).name or "(unnamed)" for b in roots) or "none"
        choose = f"; choose one with robot.root={next(iter(known))}" if roots else ""
        raise RobotError(
            f"{file}: expected one root body with joints under the world, got {len(roots)}: {names}{choose}."
        )
    return roots[0]


def _floats(model: mujoco.MjModel, body: int) -> bool:
    start, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    return any(joint_kind(model, j) == "free" for j in range(start, start + count))


def base_joints(model: mujoco.MjModel, root: int) -> range:
    """Return the indices of the base's joints: all of the root body's own, if one of them can displace it.

    A root body that only turns about a fixed point has no base: its joints are ordinary joints.
    """
    start = int(model.body_jntadr[root])
    own = range(start, start + int(model.body_jntnum[root]))
    displaced = any(joint_kind(model, j) in ("free", "slide") for j in own)
    return own if displaced else range(0)


def read_joints(model: mujoco.MjModel, root: int, file: Path, driven: bool = False) -> list[Joint]:
    """Read the joints of the robot outside its base, in the MJCF's order; joints of one body form a chain.

    Args:
        model: The model.
        root: Index of the robot's root body.
        file: Path of the MJCF, for messages.
        driven: Whether to read only those with an actuator of their own, if any has one. The parent of a joint is
            then the next of them towards the root.

    Raises:
        RobotError: If the robot has no joint outside its base.
    """
    joints: list[Joint] = []
    last_on_body: dict[int, str] = {}
    base, robot = base_joints(model, root), set(bodies_below(model, root))
    own = [i for i in range(model.njnt) if int(model.jnt_bodyid[i]) in robot and i not in base]
    moved = set(driven_joints(model)) if driven else set()
    for i in [i for i in own if i in moved] or own:
        body = int(model.jnt_bodyid[i])
        name = joint_name(model, i)
        above = body
        while above and above not in last_on_body:
            above = int(model.body_parentid[above])
        limited = bool(model.jnt_limited[i])
        low, high = (float(v) for v in model.jnt_range[i]) if limited else (-np.inf, np.inf)
        joints.append(
            Joint(
                name=name,
                parent=last_on_body.get(above),
                body=body_name(model, body),
                qpos=int(model.jnt_qposadr[i]),
                qvel=int(model.jnt_dofadr[i]),
                range=(low, high),
                kind=joint_kind(model, i),
                id=i,
            )
        )
        last_on_body[body] = name
    if not joints:
        raise RobotError(f"{file} has no joint below its root body {body_name(model, root)!r}.")
    return joints


def read_actuated(model: mujoco.MjModel, joints: Sequence[Joint]) -> list[str]:
    """Return the joint that each actuator drives, for those that drive one of ``joints``; motors and servos alike."""
    names = {joint.id: joint.name for joint in joints}
    return [names[joint] for joint in driven_joints(model) if joint in names]


def driven_joints(model: mujoco.MjModel) -> list[int]:
    """Return the index of the joint of each actuator that drives one, in order."""
    on_joint = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    return [int(model.actuator_trnid[i, 0]) for i in range(model.nu) if model.actuator_trntype[i] in on_joint]


def colliding_geoms(model: mujoco.MjModel, body: int) -> list[int]:
    """Return the indices of a body's geoms that can collide, by their types or as part of an explicit pair."""
    start = int(model.body_geomadr[body])
    own = range(start, start + int(model.body_geomnum[body]))
    paired = {*model.pair_geom1.tolist(), *model.pair_geom2.tolist()}
    return [g for g in own if model.geom_contype[g] or model.geom_conaffinity[g] or g in paired]


def leaf_bodies(model: mujoco.MjModel, root: int) -> list[int]:
    """Return the indices of the chains' ends: bodies below ``root`` that can collide and carry none that can."""
    colliding = [b for b in bodies_below(model, root) if b != root and colliding_geoms(model, b)]
    inner = {root}
    for body in colliding:
        above = int(model.body_parentid[body])
        while above and above not in inner:
            inner.add(above)
            above = int(model.body_parentid[above])
    return [body for body in colliding if body not in inner]


def named_pose(model: mujoco.MjModel) -> tuple[str, np.ndarray] | None:
    """Return the MJCF's name of the standing pose and its ``qpos`` ``[nq]``; ``None`` if it names none.

    The pose is the key ``stand``; else the key ``home`` (MuJoCo Menagerie); else the custom numeric ``init_qpos``
    (Gymnasium's older models).
    """
    keys = {model.key(key).name: key for key in reversed(range(model.nkey))}
    for name in ("stand", "home"):
        if name in keys:
            return f"key {name!r}", model.key_qpos[keys[name]].copy()
    for i in range(model.nnumeric):
        if model.numeric(i).name == "init_qpos" and int(model.numeric_size[i]) == model.nq:
            start = int(model.numeric_adr[i])
            return "numeric 'init_qpos'", model.numeric_data[start : start + model.nq].copy()
    return None


def standing_pose(model: mujoco.MjModel) -> np.ndarray:
    """Return the ``qpos`` of the named standing pose, else of the reference pose, at any height. ``[nq]``."""
    named = named_pose(model)
    return model.qpos0.copy() if named is None else named[1]
