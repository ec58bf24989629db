"""A legged robot read from an MJCF: its base, joints, feet and left/right mirror, and the requirements for walking.

Stage one of the data flow. Needs MuJoCo and NumPy, nothing else.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np

from gctd3.errors import RobotError
from gctd3.robots.actuators import check_servos
from gctd3.robots.feet import find_feet, named_feet
from gctd3.robots.floating_base import AXES, Axis, Base, find_forward
from gctd3.robots.mirror_pairs import count_reflected, pair_joints, reflected_sign, swap_side
from gctd3.robots.mjcf import Joint, body_name, load_mjcf, read_actuated, read_joints, root_body
from gctd3.robots.standing_pose import check_standing, find_standing, find_start


@dataclass(frozen=True)
class Robot:
    """Represent a robot with a root body and joints below it; :meth:`check_walking` checks the requirements of walking.

    Build it with :meth:`from_mjcf`, which reads its properties from the model.

    Attributes:
        model: The compiled MuJoCo model.
        path: The MJCF file, or the label of a model in memory.
        root: Name of the body that carries the base joints.
        joints: All joints outside the base, in the order of the MJCF (depth first).
        actuated: For each actuator of a joint, in order, the name of the joint that it drives.
        feet: Names of the bodies that may touch the ground.
        forward_axis: Forward direction: ``x``, ``-x``, ``y`` or ``-y`` of the world.
    """

    model: mujoco.MjModel
    path: Path
    root: str
    joints: tuple[Joint, ...]
    actuated: tuple[str, ...]
    feet: tuple[str, ...]
    forward_axis: Axis = "x"

    @classmethod
    def from_mjcf(
        cls,
        source: str | Path | mujoco.MjModel | mujoco.MjSpec,
        feet: str | Sequence[str] | None = None,
        forward: Axis | None = None,
    ) -> Robot:
        """Read a robot from an MJCF file or a model in memory.

        Args:
            source: An MJCF file, the name of a robot that ships with the library (``"biped"``), or a model in memory.
            feet: Names of the bodies (or of their geoms) that may touch the ground; by default those at the ends of
                the legs that stand on it, see :func:`.find_feet`.
            forward: Forward direction; by default see :func:`.find_forward`.

        Raises:
            RobotError: If the file is missing, does not parse, or has no one root, no joint or no foot.
        """
        model, file = load_mjcf(source)
        root = root_body(model, file)
        joints = read_joints(model, root, file)
        if forward is not None and forward not in AXES:
            raise RobotError(f"forward must be one of {', '.join(AXES)}, got {forward!r}.")
        if forward is None:
            reflected = {axis: count_reflected(model, joints, Base(model, root, axis).frame[1]) for axis in ("x", "y")}
            forward = find_forward(model, root, joints, reflected)
        names = find_feet(model, root, file) if feet is None else named_feet(model, root, feet, file)
        actuated = tuple(read_actuated(model, joints))
        return cls(model, file, body_name(model, root), tuple(joints), actuated, tuple(names), forward)

    # Base.

    @cached_property
    def base(self) -> Base:
        """Return the base: the degrees of freedom of the root body."""
        return Base(self.model, root_body(self.model, self.path), self.forward_axis)

    @property
    def forward(self) -> int:
        """Return the index in ``qpos`` of the coordinate along the forward axis (m); on slides, in ``qvel`` too."""
        return self._index("forward")

    @property
    def vertical(self) -> int:
        """Return the index in ``qpos`` of the coordinate along z (m); on slides, in ``qvel`` too."""
        return self._index("height")

    def _index(self, coordinate: str) -> int:
        axis = self.base.frame[{"forward": 0, "height": 2}[coordinate]]
        if self.base.free is not None:
            return self.base.free.qpos + int(np.argmax(np.abs(axis)))
        if coordinate not in self.base.single:
            raise RobotError(
                f"{self.path}: the root body {self.root!r} has no slide joint along "
                f"{'xyz'[int(np.argmax(np.abs(axis)))]}; "
                "a robot that walks needs a free joint, or slides along its forward axis and along z."
            )
        return self.base.single[coordinate].qpos

    @cached_property
    def standing_qpos(self) -> np.ndarray:
        """Return the ``qpos`` of standing, the reference of heights; see :func:`.find_standing`. Shape ``[nq]``."""
        return find_standing(self.base, [self._bodies[foot] for foot in self.feet])

    @cached_property
    def start_qpos(self) -> np.ndarray:
        """Return the ``qpos`` in which episodes begin, without noise; see :func:`.find_start`. Shape ``[nq]``."""
        return find_start(self.base, self.standing_qpos)

    # Joints and actuators.

    def joint(self, name: str) -> Joint:
        """Return the joint with a given name.

        Raises:
            RobotError: If no joint has this name; the message lists the joints.
        """
        for joint in self.joints:
            if joint.name == name:
                return joint
        raise RobotError(f"{self.path} has no joint {name!r}; it has {', '.join(j.name for j in self.joints)}.")

    @property
    def action_names(self) -> tuple[str, ...]:
        """Return the names of the actuators, in the order of the action. Length ``A``."""
        return tuple(self.model.actuator(i).name or joint for i, joint in enumerate(self.actuated))

    @property
    def action_range(self) -> np.ndarray:
        """Return the lower and upper desired joint angle (rad) of each actuator. Shape ``[A, 2]``."""
        return self.model.actuator_ctrlrange.copy()

    @cached_property
    def legs(self) -> tuple[tuple[Joint, ...], ...]:
        """Return for each foot the joints from the root down to it."""
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
        """Return the sign of each hip's angle relative to its mirror image, if that comes first, else 1. ``[feet]``."""
        mirrored = self.mirror_feet
        return np.array([self.mirror_sign(leg[0].name) if mirrored[i] < i else 1.0 for i, leg in enumerate(self.legs)])

    def _joints_above(self, body: str) -> list[Joint]:
        index = self._bodies[body]
        while index:
            moving = [j for j in self.joints if self._bodies[j.body] == index]
            if moving:
                return moving
            index = int(self.model.body_parentid[index])
        return []

    @cached_property
    def _bodies(self) -> dict[str, int]:
        return {body_name(self.model, b): b for b in range(self.model.nbody)}

    # Contacts.

    def contact_sensors(self, bodies: Sequence[str]) -> np.ndarray:
        """Return the index in ``sensordata`` of each body's ground-contact count. Shape ``[len(bodies)]``.

        Raises:
            RobotError: If a body has no ``<contact ... data="found"/>`` sensor.
        """
        sensors = self._contact_sensors
        missing = [body for body in bodies if body not in sensors]
        if missing:
            raise RobotError(
                f"{self.path} has no ground-contact sensor for {', '.join(missing)}; add for each "
                '<sensor><contact body1="NAME" geom2="GROUND" data="found"/></sensor>.'
            )
        return np.array([sensors[body] for body in bodies], dtype=np.int64)

    @property
    def other_contact_bodies(self) -> tuple[str, ...]:
        """Return the bodies other than feet with a ground-contact sensor: their contact counts as a fall."""
        return tuple(body for body in self._contact_sensors if body not in self.feet)

    @cached_property
    def _contact_sensors(self) -> dict[str, int]:
        model, sensors = self.model, {}
        for i in range(model.nsensor):
            is_contact = model.sensor_type[i] == mujoco.mjtSensor.mjSENS_CONTACT
            if is_contact and model.sensor_objtype[i] == mujoco.mjtObj.mjOBJ_BODY:
                sensors[body_name(model, int(model.sensor_objid[i]))] = int(model.sensor_adr[i])
        return sensors

    # Mirror: reflection in the sagittal plane.

    @cached_property
    def mirror(self) -> dict[str, str]:
        """Return the mirror image of each joint, by name; a joint without one is its own."""
        last = {leg[-1].name for leg in self.legs if leg}
        return pair_joints(self.model, self.joints, last, self.base.frame[1])

    def mirror_name(self, name: str) -> str:
        """Return the name of the same joint or body on the other side, or ``name`` if it has no side."""
        if name in self.mirror:
            return self.mirror[name]
        other = swap_side(name, self._bodies)
        if other != name:
            return other
        moved = [joint.name for joint in self.joints if joint.body == name]
        return self.joint(self.mirror[moved[-1]]).body if moved else name

    def mirror_sign(self, name: str) -> float:
        """Compare a joint's axis with its partner's: +1 if equal angles mirror each other, -1 if opposite ones do."""
        return reflected_sign(self.model, self.joint(name), self.joint(self.mirror[name]), self.base.frame[1])

    @cached_property
    def mirror_feet(self) -> tuple[int, ...]:
        """Return for each foot the index of its mirror image; its own index if that is no foot."""
        ends = [leg[-1].name if leg else None for leg in self.legs]
        order = []
        for i, (foot, end) in enumerate(zip(self.feet, ends, strict=True)):
            other = self.mirror_name(foot)
            same = [k for k, name in enumerate(ends) if end is not None and name == self.mirror[end]]
            order.append(self.feet.index(other) if other in self.feet else same[0] if len(same) == 1 else i)
        return tuple(other if order[other] == i else i for i, other in enumerate(order))

    @cached_property
    def foot_pairs(self) -> tuple[tuple[int, ...], ...]:
        """Group the feet by ground node: up to two feet share one; of more, each joins its mirror image."""
        if len(self.feet) <= 2:
            return (tuple(range(len(self.feet))),)
        return tuple((i, other) if other != i else (i,) for i, other in enumerate(self.mirror_feet) if i <= other)

    @cached_property
    def action_mirror(self) -> tuple[np.ndarray, np.ndarray]:
        """Return permutation and sign: ``sign * action[..., permutation]`` is the mirrored action. Each ``[A]``.

        Raises:
            RobotError: If a joint has an actuator and its mirror image has none.
        """
        unpaired = [name for name in self.actuated if self.mirror[name] not in self.actuated]
        if unpaired:
            raise RobotError(f"{self.path}: the mirror image of {', '.join(unpaired)} has no actuator.")
        order = [self.actuated.index(self.mirror[name]) for name in self.actuated]
        sign = [self.mirror_sign(name) for name in self.actuated]
        return np.array(order), np.array(sign)

    # Requirements of the walking task beyond a graph.

    def check_legs(self) -> None:
        """Raise a :class:`.RobotError` that names a foot which is not the end of a leg, if any."""
        for foot, leg in zip(self.feet, self.legs, strict=True):
            if not leg:
                raise RobotError(
                    f"{self.path}: foot {foot!r} hangs on no joint, so it is no leg's end; name other feet."
                )

    def check_walking(self) -> None:
        """Check the requirements for walking: base, hinges, position servos, legs, contact sensors, pose and mirror.

        Raises:
            RobotError: If something is missing; the message names the remedy.
        """
        model, file = self.model, self.path
        self.base.check_read(file)
        _ = self.forward, self.vertical
        for joint in self.joints:
            if joint.kind != "hinge":
                raise RobotError(
                    f"{file}: joint {joint.name!r} of body {joint.body!r} must be a hinge, is a {joint.kind}."
                )
        check_servos(model, self.joints, file)
        self.check_legs()
        self.contact_sensors(self.feet)
        check_standing(self.base, [self._bodies[foot] for foot in self.feet], file)
        _ = self.action_mirror
