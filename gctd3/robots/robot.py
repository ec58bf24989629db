"""A legged robot read from an MJCF: its base, joints, feet and left/right mirror, and the requirements for walking.

Stage one of the data flow. Needs MuJoCo and NumPy, nothing else.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from gctd3.errors import RobotError
from gctd3.robots.actuators import check_servos
from gctd3.robots.blueprint import Blueprint
from gctd3.robots.feet import find_feet, foot_place, named_feet
from gctd3.robots.floating_base import AXES, Axis, Base, find_forward
from gctd3.robots.ground import contact_sensors, velocity_sensors
from gctd3.robots.legs import find_hips, find_legs, measure_leg_length
from gctd3.robots.mirror_pairs import Plane
from gctd3.robots.mjcf import (
    Joint,
    body_name,
    load_mjcf,
    read_actuated,
    read_joints,
    root_body,
)
from gctd3.robots.robot_mirror import RobotMirror
from gctd3.robots.standing_pose import check_standing, find_standing, find_start

if TYPE_CHECKING:
    from gctd3.robots.mirror_check import MirrorCheck
    from gctd3.robots.portable import Written
    from gctd3.robots.sources import Source


@dataclass(frozen=True)
class Robot:
    """Represent a robot with a root body and joints below it; :meth:`check_walking` checks the requirements of walking.

    Build it with :meth:`from_mjcf`, which reads its properties from the model.

    Attributes:
        model: The compiled MuJoCo model.
        path: The MJCF file, or the label of a model in memory.
        root: Name of the body that carries the base joints.
        joints: The joints outside the base, in the order of the MJCF (depth first); those of a completed file are
            the driven ones.
        actuated: For each actuator of a joint, in order, the name of the joint that it drives.
        feet: Names of the bodies that may touch the ground.
        forward_axis: Forward direction: ``x``, ``-x``, ``y`` or ``-y`` of the world.
        action_scale: Change of each desired angle from the standing pose by an action of 1 (rad); ``None`` if actions
            are mapped onto the servos' ranges.
        standing_command: Desired angle of each servo that holds the standing pose against the robot's weight (rad),
            see :func:`.find_standing_command`; ``None`` for the angles of the pose.
        source: Where the file comes from; ``None`` for a model in memory.
        notes: One sentence for each thing that was added to the file or changed.
        held: Angle (rad) of each joint of the file that was fixed, by name.
        written: What a run keeps of it; ``None`` for a model in memory, in other processes and in copies.
        blueprint: Its uncompiled file; ``None`` for a compiled model in memory, in other processes and in copies.
    """

    model: mujoco.MjModel
    path: Path
    root: str
    joints: tuple[Joint, ...]
    actuated: tuple[str, ...]
    feet: tuple[str, ...]
    forward_axis: Axis = "x"
    action_scale: tuple[float, ...] | None = None
    standing_command: tuple[float, ...] | None = None
    source: Source | None = field(default=None, compare=False)
    notes: tuple[str, ...] = field(default=(), compare=False)
    held: Mapping[str, float] = field(default_factory=dict, compare=False)
    written: Written | None = field(default=None, compare=False, repr=False)
    blueprint: Blueprint | None = field(default=None, compare=False, repr=False)

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
        robot = cls.from_model(model, file, feet, forward)
        if isinstance(source, mujoco.MjModel):
            return robot
        spec = source.copy() if isinstance(source, mujoco.MjSpec) else None
        read = spec.copy if spec is not None else functools.partial(mujoco.MjSpec.from_file, str(file))
        return replace(robot, blueprint=Blueprint(read))

    @classmethod
    def from_model(
        cls,
        model: mujoco.MjModel,
        file: Path,
        feet: str | Sequence[str] | None = None,
        forward: Axis | None = None,
        *,
        root_name: str | None = None,
        driven: bool = False,
        source: Source | None = None,
        notes: tuple[str, ...] = (),
        held: Mapping[str, float] | None = None,
    ) -> Robot:
        """Read a robot from the compiled model of a file, which messages name; see :meth:`from_mjcf`.

        Args:
            model: The compiled model.
            file: Path of the file, for messages.
            feet: See :meth:`from_mjcf`.
            forward: See :meth:`from_mjcf`.
            root_name: Name of the root body; ``None`` where there is but one robot.
            driven: Whether joints without an actuator, if others have one, are none of the robot's :attr:`joints`.
            source: Where the file comes from.
            notes: One sentence for each thing that was added to the file or changed.
            held: Angle (rad) of each joint of the file that was fixed, by name.
        """
        root = root_body(model, file, root_name)
        joints = read_joints(model, root, file, driven)
        if forward is not None and forward not in AXES:
            raise RobotError(f"forward must be one of {', '.join(AXES)}, got {forward!r}.")
        if forward is None:
            forward = find_forward(model, root, joints)
        names = find_feet(model, root, file) if feet is None else named_feet(model, root, feet, file)
        actuated = tuple(read_actuated(model, joints))
        return cls(
            model,
            file,
            body_name(model, root),
            tuple(joints),
            actuated,
            tuple(names),
            forward,
            source=source,
            notes=notes,
            held=held or {},
        )

    @property
    def origin(self) -> str:
        """Return the origin of the file and the additions to it, a line each; nothing for an unchanged shipped file."""
        if self.source is None or (self.source.ships and not self.notes):
            return ""
        return "\n".join([f"Robot: {self.source}", *(f"  {note}" for note in self.notes)])

    # Base.

    @cached_property
    def base(self) -> Base:
        """Return the base: the degrees of freedom of the root body."""
        return Base(self.model, root_body(self.model, self.path, self.root), self.forward_axis)

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

    @cached_property
    def inner_joints(self) -> tuple[int, ...]:
        """Return MuJoCo's indices of all joints outside the base, driven or not."""
        return tuple(joint.id for joint in read_joints(self.model, self.base.root, self.path))

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

    @property
    def home_angles(self) -> np.ndarray:
        """Return the angle of each joint in the pose in which episodes begin, shape ``[J]`` (rad); 0 of a ball."""
        return np.array([0.0 if joint.kind == "ball" else self.start_qpos[joint.qpos] for joint in self.joints])

    @cached_property
    def action_map(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the desired angle of each actuator at an action of 0, and its change by an action of 1. Each ``[A]``.

        Without :attr:`action_scale` [-1, 1] is mapped onto the servos' ranges, affinely (Table 2 of the paper). With it
        an action of 0 holds the standing pose.
        """
        low, high = self.action_range.T
        if self.action_scale is None:
            return (high + low) / 2, (high - low) / 2
        if self.standing_command is not None:
            return np.array(self.standing_command), np.array(self.action_scale)
        home = self.start_qpos[[self.joint(name).qpos for name in self.actuated]]
        return np.clip(home, low, high), np.array(self.action_scale)

    def desired_angles(self, action: np.ndarray) -> np.ndarray:
        """Compute the desired joint angles (rad) of actions in [-1, 1], each of shape ``[*, A]``.

        Larger actions count as 1, and no angle leaves the servo's range.
        """
        centre, scale = self.action_map
        desired = centre + scale * np.clip(action, -1.0, 1.0)
        if self.action_scale is None:
            return np.asarray(desired)
        low, high = self.action_range.T
        return np.asarray(np.clip(desired, low, high))

    @cached_property
    def legs(self) -> tuple[tuple[Joint, ...], ...]:
        """Return for each foot the joints from the root down to it."""
        return find_legs(self.model, self.joints, self.foot_bodies)

    @cached_property
    def hips(self) -> tuple[Joint, ...]:
        """Return for each foot the hip, see :func:`.find_hips`."""
        return find_hips(self.model, self.standing_qpos, self.base.frame, self.legs, self.foot_bodies)

    @cached_property
    def leg_length(self) -> float:
        """Return the height of the hips above the ground when standing, the mean over legs (m)."""
        return measure_leg_length(self.model, self.standing_qpos, self.hips, self.foot_bodies)

    @property
    def foot_bodies(self) -> tuple[int, ...]:
        """Return MuJoCo's index of each foot's body, which may have no name."""
        return tuple(self._bodies[foot] for foot in self.feet)

    def foot_place(self, data: mujoco.MjData, foot: str) -> np.ndarray:
        """Return the mean place of a foot's colliding geoms, or the body's own (m, in the world)."""
        return foot_place(self.model, data, self._bodies[foot])

    @cached_property
    def hip_signs(self) -> np.ndarray:
        """Return the sign of each hip's angle relative to its mirror image, if that comes first, else 1. ``[feet]``."""
        mirrored = self.mirror_feet
        return np.array([self.mirror_sign(hip.name) if mirrored[i] < i else 1.0 for i, hip in enumerate(self.hips)])

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

    @cached_property
    def foot_velocity_sensors(self) -> np.ndarray | None:
        """Return the indices in ``sensordata`` of each foot's velocity in the world, shape ``[feet, 3]``.

        ``None`` if a foot has no ``<framelinvel/>`` sensor of a site of its own, or else of its body.
        """
        sensors = velocity_sensors(self.model)
        if any(foot not in sensors for foot in self.feet):
            return None
        return np.array([sensors[foot] for foot in self.feet])[:, None] + np.arange(3)

    @property
    def other_contact_bodies(self) -> tuple[str, ...]:
        """Return the bodies other than feet and shanks with a ground-contact sensor: their contact counts as a fall."""
        return tuple(b for b in self._contact_sensors if b not in self.feet and b not in self._shanks)

    @property
    def shanks(self) -> tuple[str, ...]:
        """Return the bodies that carry a foot, which is a body of its own, and have a ground-contact sensor."""
        return tuple(body for body in self._contact_sensors if body in self._shanks)

    @cached_property
    def _shanks(self) -> set[str]:
        return {leg[-1].body for leg in self.legs if leg} - set(self.feet)

    @cached_property
    def _contact_sensors(self) -> dict[str, int]:
        return contact_sensors(self.model, self.base.root)

    # Mirror: reflection in the sagittal plane.

    @cached_property
    def _mirror(self) -> RobotMirror:
        return RobotMirror(self.base, self.joints, self.legs, self.feet, self.standing_qpos)

    @property
    def mirror(self) -> dict[str, str]:
        """Return the mirror image of each joint, by name; a joint without one is its own."""
        return self._mirror.pairs.images

    @property
    def mirror_plane(self) -> Plane:
        """Return the sagittal plane, where it is in the standing pose."""
        return self._mirror.pairs.plane

    def mirror_name(self, name: str) -> str:
        """Return the name of the same joint or body on the other side, or ``name`` if there is none."""
        return self._mirror.image(name)

    def mirror_sign(self, name: str) -> float:
        """Compare a joint's axis with its partner's: +1 if equal angles mirror each other, -1 if opposite ones do."""
        return self._mirror.signs[name]

    @property
    def mirror_feet(self) -> tuple[int, ...]:
        """Return for each foot the index of its mirror image; its own index if that is no foot."""
        return self._mirror.feet

    @cached_property
    def foot_pairs(self) -> tuple[tuple[int, ...], ...]:
        """Group the feet by ground node: up to two feet share one; of more, each joins its mirror image."""
        if len(self.feet) <= 2:
            return (tuple(range(len(self.feet))),)
        return tuple((i, other) if other != i else (i,) for i, other in enumerate(self.mirror_feet) if i <= other)

    @cached_property
    def mirror_checks(self) -> dict[float, MirrorCheck]:
        """Return the verdicts of :func:`.check_mirror` so far, by control period (s)."""
        return {}

    @cached_property
    def grounds(self) -> dict[str, Any]:
        """Return what was built of each uneven ground so far, by a description of the ground."""
        return {}

    @cached_property
    def action_mirror(self) -> tuple[np.ndarray, np.ndarray]:
        """Return permutation and sign: ``sign * action[..., permutation]`` is the mirrored action. Each ``[A]``."""
        return self._mirror.actions(self.actuators, self.actuated)

    @property
    def actuators(self) -> tuple[int, ...]:
        """Return MuJoCo's index of the actuator of each joint of :attr:`actuated`."""
        model, ids = self.model, {joint.id for joint in self.joints}
        on_joint = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
        driving = [i for i in range(model.nu) if model.actuator_trntype[i] in on_joint]
        return tuple(i for i in driving if int(model.actuator_trnid[i, 0]) in ids)

    # Requirements of the walking task beyond a graph.

    def check_legs(self) -> None:
        """Raise a :class:`.RobotError` that names a foot which is not the end of a leg, if any."""
        for foot, leg in zip(self.feet, self.legs, strict=True):
            if not leg:
                raise RobotError(
                    f"{self.path}: foot {foot!r} hangs on no joint, so it is no leg's end; name other feet."
                )

    def check_walking(self) -> None:
        """Check the requirements for walking: base, hinges, position servos, legs, contact sensors and pose.

        Raises:
            RobotError: If something is missing; the message names the remedy.
        """
        model, file = self.model, self.path
        self.base.check_read(file)
        _ = self.forward, self.vertical
        for joint in self.joints:
            if joint.kind != "hinge":
                raise RobotError(
                    f"{file}: joint {joint.name!r} of body {joint.body!r} must be a hinge, is a {joint.kind}; "
                    "robot.hold can fix it."
                )
        check_servos(model, self.joints, file)
        self.check_legs()
        self.contact_sensors(self.feet)
        check_standing(self.base, [self._bodies[foot] for foot in self.feet], file)
