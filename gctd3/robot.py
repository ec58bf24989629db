"""A legged robot read from an MJCF file: its joints, actuators, feet, limits and left/right mirror.

Stage one of the data flow. Needs MuJoCo and NumPy, nothing else.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np

from gctd3.errors import RobotError
from gctd3.mjcf import Joint, find_mjcf, leaf_bodies, read_actuated, read_joints, root_body

_SIDES = (("right", "left"), ("Right", "Left"), ("R", "L"), ("r", "l"))


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
        root = root_body(model, file)
        joints = tuple(read_joints(model, root, file))
        actuated = tuple(read_actuated(model, joints, file))
        names = tuple(feet) if feet is not None else tuple(leaf_bodies(model, root))
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

    @cached_property
    def hip_signs(self) -> np.ndarray:
        """Factors that make every leg's hip angle count in the first leg's sense. Shape ``[feet]``."""
        return np.array([1.0, *(self.mirror_sign(leg[0].name) for leg in self.legs[1:])])

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
