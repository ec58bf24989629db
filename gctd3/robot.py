"""A legged robot read from an MJCF file: its joints, actuators, feet, limits and left/right mirror.

Stage one of the data flow. Needs MuJoCo and NumPy, nothing else.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from pathlib import Path

import mujoco
import numpy as np

from gctd3.errors import RobotError

_SIDES = (("right", "left"), ("Right", "Left"), ("R", "L"), ("r", "l"))


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


@dataclass(frozen=True)
class Robot:
    """A robot on a boom: it slides along x and z, and position servos move its hinges.

    Build it with :meth:`from_mjcf`; nothing about it is typed in.

    Attributes:
        model: The compiled MuJoCo model.
        path: The MJCF file.
        root: Name of the body that carries the base joints.
        joints: All hinges below the root, in the order of the MJCF (depth first).
        actuated: For each actuator, in order, the name of the joint that it drives.
        feet: Names of the bodies that may touch the ground.
    """

    model: mujoco.MjModel
    path: Path
    root: str
    joints: tuple[Joint, ...]
    actuated: tuple[str, ...]
    feet: tuple[str, ...]

    @classmethod
    def from_mjcf(cls, path: str | Path, feet: Sequence[str] | None = None) -> Robot:
        """Read a robot.

        Args:
            path: An MJCF file, or the name of a robot that ships with the library (``"biped"``).
            feet: Names of the bodies that may touch the ground; by default the last body of every leg that can collide.

        Raises:
            RobotError: If the file is missing, does not parse, or has no usable base, actuator, foot or contact sensor.
        """
        file = find_mjcf(path)
        try:
            model = mujoco.MjModel.from_xml_path(str(file))
        except ValueError as error:
            raise RobotError(f"{file} is not an MJCF that MuJoCo can compile: {error}") from error
        if model.nu == 0:
            raise RobotError(f"{file} has no actuator: add a <position> for every joint that the policy is to move.")
        root = _root_body(model, file)
        joints = tuple(_joints(model, root, file))
        actuated = tuple(_actuated(model, joints, file))
        names = tuple(feet) if feet is not None else tuple(_leaf_bodies(model, root))
        robot = cls(model, file, model.body(root).name, joints, actuated, names)
        robot._check_feet()
        _ = robot.forward, robot.vertical, robot.action_mirror
        return robot

    # Base: the boom.

    @property
    def forward(self) -> int:
        """Index in ``qpos`` and ``qvel`` of the slide along x (m, m/s)."""
        return self._slide(0)

    @property
    def vertical(self) -> int:
        """Index in ``qpos`` and ``qvel`` of the slide along z (m, m/s)."""
        return self._slide(2)

    def _slide(self, axis: int) -> int:
        for joint in self._base_joints():
            direction = np.abs(self.model.jnt_axis[joint])
            if self.model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE and direction[axis] > 0.999:
                return int(self.model.jnt_qposadr[joint])
        raise RobotError(
            f"{self.path}: the root body {self.root!r} has no slide joint along {'xyz'[axis]}; "
            "a boom base needs one along x and one along z."
        )

    def _base_joints(self) -> range:
        body = self.model.body(self.root).id
        start = int(self.model.body_jntadr[body])
        return range(start, start + int(self.model.body_jntnum[body]))

    @cached_property
    def standing_qpos(self) -> np.ndarray:
        """``qpos`` of the key ``stand``, or the model's reference pose. Shape ``[nq]``."""
        for key in range(self.model.nkey):
            if self.model.key(key).name == "stand":
                return self.model.key_qpos[key].copy()
        return self.model.qpos0.copy()

    # Joints and actuators.

    def joint(self, name: str) -> Joint:
        """The joint of that name.

        Raises:
            RobotError: If there is none; the message lists those there are.
        """
        for joint in self.joints:
            if joint.name == name:
                return joint
        raise RobotError(f"{self.path} has no joint {name!r}; it has {', '.join(j.name for j in self.joints)}.")

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the actuators, in the order of the action. Length ``A``."""
        return tuple(self.model.actuator(i).name or joint for i, joint in enumerate(self.actuated))

    @property
    def action_range(self) -> np.ndarray:
        """Lower and upper desired joint angle (rad) of each actuator. Shape ``[A, 2]``."""
        return self.model.actuator_ctrlrange.copy()

    @cached_property
    def legs(self) -> tuple[tuple[Joint, ...], ...]:
        """For each foot, the joints from the root down to it."""
        chains = []
        for foot in self.feet:
            chain: list[Joint] = []
            last = [j for j in self.joints if j.body == foot] or self._joints_above(foot)
            name: str | None = last[-1].name if last else None
            while name is not None:
                chain.append(self.joint(name))
                name = chain[-1].parent
            chains.append(tuple(reversed(chain)))
        return tuple(chains)

    def _joints_above(self, body: str) -> list[Joint]:
        index = self.model.body(body).id
        while index:
            found = [j for j in self.joints if j.body == self.model.body(index).name]
            if found:
                return found
            index = int(self.model.body_parentid[index])
        return []

    # Contacts.

    def contact_sensors(self, bodies: Sequence[str]) -> np.ndarray:
        """Index in ``sensordata`` of each body's ground-contact count. Shape ``[len(bodies)]``.

        Raises:
            RobotError: If a body has no ``<contact ... data="found"/>`` sensor.
        """
        found = self._contact_sensors
        missing = [body for body in bodies if body not in found]
        if missing:
            raise RobotError(
                f"{self.path} has no ground-contact sensor for {', '.join(missing)}; add for each "
                '<sensor><contact body1="NAME" geom2="GROUND" data="found"/></sensor>.'
            )
        return np.array([found[body] for body in bodies], dtype=np.int64)

    @property
    def other_contact_bodies(self) -> tuple[str, ...]:
        """Bodies with a ground-contact sensor that are not feet: their touch is a fall."""
        return tuple(body for body in self._contact_sensors if body not in self.feet)

    @cached_property
    def _contact_sensors(self) -> dict[str, int]:
        model, found = self.model, {}
        for i in range(model.nsensor):
            is_contact = model.sensor_type[i] == mujoco.mjtSensor.mjSENS_CONTACT
            if is_contact and model.sensor_objtype[i] == mujoco.mjtObj.mjOBJ_BODY:
                found[model.body(int(model.sensor_objid[i])).name] = int(model.sensor_adr[i])
        return found

    def _check_feet(self) -> None:
        bodies = [self.model.body(i).name for i in range(1, self.model.nbody)]
        unknown = [foot for foot in self.feet if foot not in bodies]
        if unknown:
            raise RobotError(f"{self.path} has no body {', '.join(unknown)}; its bodies are {', '.join(bodies)}.")
        if not self.feet:
            raise RobotError(f"{self.path} has no foot: no leg ends in a body with a geom that collides.")
        self.contact_sensors(self.feet)

    # Mirror: reflection in the sagittal (xz) plane.

    def mirror_name(self, name: str) -> str:
        """The name of the same part on the other side, or ``name`` if it has no side."""
        joints, bodies = {j.name for j in self.joints}, {self.model.body(i).name for i in range(self.model.nbody)}
        known = joints if name in joints else bodies
        for right, left in _SIDES:
            for here, there in ((right, left), (left, right)):
                swapped = re.sub(rf"(?<![a-zA-Z]){here}(?![a-zA-Z])", there, name)
                if swapped != name and swapped in known:
                    return swapped
        return name

    def mirror_sign(self, name: str) -> float:
        """+1 if equal angles mirror each other, -1 if opposite ones do (axis against its mirrored partner's)."""
        here, there = self.model.joint(name), self.model.joint(self.mirror_name(name))
        # A rotation axis is a pseudo-vector: the reflection y -> -y keeps its y and turns its x and z round.
        reflected = here.axis * np.array([-1.0, 1.0, -1.0])
        return 1.0 if float(reflected @ there.axis) > 0.0 else -1.0

    @cached_property
    def action_mirror(self) -> tuple[np.ndarray, np.ndarray]:
        """Permutation and sign with which ``sign * action[..., permutation]`` is the mirrored action. Each ``[A]``.

        Raises:
            RobotError: If a joint has an actuator and its mirror image has none.
        """
        lonely = [name for name in self.actuated if self.mirror_name(name) not in self.actuated]
        if lonely:
            raise RobotError(f"{self.path}: the mirror image of {', '.join(lonely)} has no actuator.")
        order = [self.actuated.index(self.mirror_name(name)) for name in self.actuated]
        sign = [self.mirror_sign(name) for name in self.actuated]
        return np.array(order), np.array(sign)

    @cached_property
    def fingerprint(self) -> str:
        """First 16 hexadecimal digits of the SHA-256 of the MJCF's text."""
        return hashlib.sha256(self.path.read_bytes()).hexdigest()[:16]


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


def _root_body(model: mujoco.MjModel, file: Path) -> int:
    roots = [b for b in range(1, model.nbody) if model.body_parentid[b] == 0 and model.body_jntnum[b] > 0]
    if len(roots) != 1:
        names = ", ".join(model.body(b).name or "(unnamed)" for b in roots) or "none"
        raise RobotError(f"{file}: expected one root body with joints under the world, got {len(roots)}: {names}.")
    return roots[0]


def _joints(model: mujoco.MjModel, root: int, file: Path) -> list[Joint]:
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


def _actuated(model: mujoco.MjModel, joints: Sequence[Joint], file: Path) -> list[str]:
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


def _leaf_bodies(model: mujoco.MjModel, root: int) -> list[str]:
    parents = {int(p) for p in model.body_parentid[1:]}
    colliding = {int(model.geom_bodyid[g]) for g in range(model.ngeom) if model.geom_contype[g]}
    return [model.body(b).name for b in range(root + 1, model.nbody) if b not in parents and b in colliding]
