"""A robot as links and joints, as URDF and SDF describe it, from its compiled MuJoCo model.

The frame of a link is that of its body, with the origin in the anchor of the joint above it. A body with several joints
is a chain of links, of which all but the last are light: both formats allow one axis a joint.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np

from gctd3.errors import RobotError
from gctd3.robots.actuators import torque_limit
from gctd3.robots.mjcf import bodies_below, body_name, colliding_geoms, joint_kind, joint_name
from gctd3.robots.robot import Robot

WORLD = "world"  # name of the link that stands for the world
# Mass (kg) and moments of inertia (kg m^2) of links that have none, and of those between several joints of a body:
# MuJoCo refuses 0, Bullet takes 0 for what cannot move, and DART makes 1e-9 of less.
LIGHT = 1e-9
Shape = Literal["box", "cylinder", "sphere", "mesh"]


@dataclass(frozen=True)
class Solid:
    """Describe a shape on a link.

    Attributes:
        name: Name of the geom, and of its part.
        shape: Shape.
        size: Full sides of a box, radius and length of a cylinder along z, radius of a sphere (m); empty for a mesh.
        position: Place on the link, shape ``[3]`` (m).
        rotation: Orientation on the link, shape ``[3, 3]``.
        collides: Whether it can touch something.
        mesh: MuJoCo's index of the mesh; -1 for other shapes.
        friction: Coefficient of sliding friction.
    """

    name: str
    shape: Shape
    size: tuple[float, ...]
    position: np.ndarray
    rotation: np.ndarray
    collides: bool
    mesh: int = -1
    friction: float = 1.0


@dataclass(frozen=True)
class Link:
    """Describe a link.

    Attributes:
        name: Name of the body, or of a light link.
        mass: Mass (kg).
        centre: Centre of mass on the link, shape ``[3]`` (m).
        inertia: Inertia about the centre of mass along the link's axes, shape ``[3, 3]`` (kg m^2).
        solids: Shapes on it.
        body: MuJoCo's index of the body; -1 for a light link.
    """

    name: str
    mass: float
    centre: np.ndarray
    inertia: np.ndarray
    solids: tuple[Solid, ...] = ()
    body: int = -1


@dataclass(frozen=True)
class LinkJoint:
    """Describe a joint between two links.

    Attributes:
        name: Name of the joint.
        kind: ``hinge``, ``slide`` or ``fixed``.
        parent: Name of the link above.
        child: Name of the link below.
        position: Origin of the link below on the link above at an angle of 0, shape ``[3]`` (m).
        rotation: Orientation of the same, shape ``[3, 3]``.
        axis: Axis on both links, shape ``[3]``.
        lower: Lower limit (rad or m), infinite for none.
        upper: Upper limit.
        effort: Largest torque of its servo (N m or N), infinite for none.
        damping: Damping (N m s/rad or N s/m).
        friction: Coulomb friction (N m or N).
        id: MuJoCo's index of the joint; -1 for a fixed one.
    """

    name: str
    kind: Literal["hinge", "slide", "fixed"]
    parent: str
    child: str
    position: np.ndarray
    rotation: np.ndarray
    axis: np.ndarray
    lower: float = -np.inf
    upper: float = np.inf
    effort: float = np.inf
    damping: float = 0.0
    friction: float = 0.0
    id: int = -1


@dataclass(frozen=True)
class Links:
    """Hold a robot's links and joints, parents before their children; the first link is the root.

    Attributes:
        links: The links, without the world.
        joints: The joint above each link; the root of a free base has none.
        free: Whether the root moves freely.
    """

    links: tuple[Link, ...]
    joints: tuple[LinkJoint, ...]
    free: bool

    @classmethod
    def of(cls, robot: Robot, armature: float = 0.0) -> Links:
        """Describe a robot.

        Args:
            robot: The robot.
            armature: Share of each joint's armature to add to the inertia of the link below it, about all three axes;
                about one alone it could be no body's.

        Raises:
            RobotError: If it has a ball joint.
        """
        return _Reading(robot, armature).links()


class _Reading:
    """Read links and joints off a compiled model."""

    def __init__(self, robot: Robot, armature: float) -> None:
        self.robot, self.model, self.armature = robot, robot.model, armature
        self.names = {WORLD}
        self.efforts = {robot.joint(n).id: torque_limit(robot, i) for i, n in enumerate(robot.actuated)}
        self.made: list[Link] = []
        self.joints: list[LinkJoint] = []
        # Of each body the name of its link, and the origin of the link on the body.
        self.origins: dict[int, tuple[str, np.ndarray]] = {0: (WORLD, np.zeros(3))}

    def links(self) -> Links:
        root = self.robot.base.root
        for body in bodies_below(self.model, root):
            self._body(body)
        return Links(tuple(self.made), tuple(self.joints), self.robot.base.free is not None)

    def _body(self, body: int) -> None:
        """Add the links and joints of a body."""
        model = self.model
        start, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        own, name = list(range(start, start + count)), self._name(body_name(model, body))
        kinds = [joint_kind(model, j) for j in own]
        if "ball" in kinds:
            ball = joint_name(model, own[kinds.index("ball")])
            raise RobotError(
                f"{self.robot.path}: joint {ball!r} is a ball, which URDF has not; robot.hold fixes joints."
            )
        above, origin = self.origins[int(model.body_parentid[body])]
        if kinds == ["free"]:
            self.origins[body] = name, np.zeros(3)
            self._link(name, body, np.zeros(3), 0.0)
            return
        # What is written is the pose at angles of 0, and MuJoCo counts from those of the reference pose. The rotation
        # of the last link and the way of its origin are those of all joints together.
        turn, place = _matrix(model.body_quat[body]), model.body_pos[body] - origin
        # Motion from the body's frame in the reference pose to that at angles of 0, joint by joint.
        for number, joint in enumerate(own):
            axis, anchor = model.jnt_axis[joint].copy(), model.jnt_pos[joint].copy()
            zero = -float(model.qpos0[int(model.jnt_qposadr[joint])])
            at = place + turn @ anchor
            if kinds[number] == "slide":
                at = at + turn @ axis * zero
            else:
                turn = turn @ _turned(axis, zero)
            last = number == count - 1
            child = name if last else self._name(f"{name}_{joint_name(model, joint)}")
            self._joint(joint, kinds[number], above, child, at, turn, axis)
            if not last:
                self._light(child, joint)
            # From here on, places are on the link just made.
            above, place, turn, origin = child, -anchor, np.eye(3), anchor
        if not own:
            fixed = self._name(f"{name}_fixed")
            self.joints.append(LinkJoint(fixed, "fixed", above, name, place, turn, np.array([1.0, 0.0, 0.0])))
            origin = np.zeros(3)
        self.origins[body] = name, origin
        self._link(name, body, origin, self._armature(own[-1:]))

    def _joint(
        self, joint: int, kind: str, above: str, child: str, at: np.ndarray, turn: np.ndarray, axis: np.ndarray
    ) -> None:
        model, dof = self.model, int(self.model.jnt_dofadr[joint])
        lower, upper = (float(v) for v in model.jnt_range[joint]) if model.jnt_limited[joint] else (-np.inf, np.inf)
        effort = self.efforts.get(joint, np.inf)
        if joint not in self.efforts and model.jnt_actfrclimited[joint]:
            effort = float(np.abs(model.jnt_actfrcrange[joint]).max())
        self.joints.append(
            LinkJoint(
                joint_name(model, joint),
                "slide" if kind == "slide" else "hinge",
                above,
                child,
                at,
                turn,
                axis,
                lower,
                upper,
                effort,
                float(model.dof_damping[dof]),
                float(model.dof_frictionloss[dof]),
                joint,
            )
        )

    def _armature(self, joints: list[int]) -> float:
        dofs = [int(self.model.jnt_dofadr[j]) for j in joints if joint_kind(self.model, j) == "hinge"]
        return self.armature * float(sum(self.model.dof_armature[dofs]))

    def _light(self, name: str, joint: int) -> None:
        own = max(LIGHT, self._armature([joint]))
        self.made.append(Link(name, LIGHT, np.zeros(3), own * np.eye(3)))

    def _link(self, name: str, body: int, origin: np.ndarray, armature: float) -> None:
        model = self.model
        frame = _matrix(model.body_iquat[body])
        inertia = frame @ np.diag(model.body_inertia[body]) @ frame.T
        solids = tuple(solid for geom in self._geoms(body) for solid in _solids(model, geom, origin))
        mass = max(float(model.body_mass[body]), LIGHT)
        if not model.body_mass[body]:
            inertia = LIGHT * np.eye(3)
        self.made.append(Link(name, mass, model.body_ipos[body] - origin, inertia + armature * np.eye(3), solids, body))

    def _geoms(self, body: int) -> list[int]:
        start = int(self.model.body_geomadr[body])
        return list(range(start, start + int(self.model.body_geomnum[body])))

    def _name(self, wanted: str) -> str:
        name, number = wanted, 2
        while name in self.names:
            name, number = f"{wanted}_{number}", number + 1
        self.names.add(name)
        return name


def _solids(model: mujoco.MjModel, geom: int, origin: np.ndarray) -> list[Solid]:
    """Return the shapes of a geom: of a capsule a cylinder and two spheres; none for one that the formats lack."""
    kind, size = mujoco.mjtGeom(int(model.geom_type[geom])), model.geom_size[geom]
    name = model.geom(geom).name or f"geom_{geom}"
    place, turn = model.geom_pos[geom] - origin, _matrix(model.geom_quat[geom])
    collides = geom in colliding_geoms(model, int(model.geom_bodyid[geom]))
    friction = float(model.geom_friction[geom, 0])

    def solid(part: str, shape: Shape, size: tuple[float, ...], shift: float = 0.0, mesh: int = -1) -> Solid:
        return Solid(name + part, shape, size, place + turn[:, 2] * shift, turn, collides, mesh, friction)

    kinds = mujoco.mjtGeom
    radius, half = float(size[0]), float(size[1])
    if kind == kinds.mjGEOM_BOX:
        return [solid("", "box", tuple(float(2 * side) for side in size))]
    if kind == kinds.mjGEOM_SPHERE:
        return [solid("", "sphere", (radius,))]
    if kind == kinds.mjGEOM_CYLINDER:
        return [solid("", "cylinder", (radius, 2 * half))]
    if kind == kinds.mjGEOM_CAPSULE:
        ends = [solid(part, "sphere", (radius,), shift) for part, shift in (("_top", half), ("_bottom", -half))]
        return [solid("", "cylinder", (radius, 2 * half)), *ends]
    if kind == kinds.mjGEOM_MESH and collides:
        return [solid("", "mesh", (), mesh=int(model.geom_dataid[geom]))]
    return []


def _matrix(quaternion: np.ndarray) -> np.ndarray:
    """Return the rotation matrix of a quaternion."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion / np.linalg.norm(quaternion))
    return matrix.reshape(3, 3)


def _turned(axis: np.ndarray, angle: float) -> np.ndarray:
    """Return the rotation matrix of an angle (rad) about an axis."""
    quaternion = np.zeros(4)
    mujoco.mju_axisAngle2Quat(quaternion, axis, angle)
    return _matrix(quaternion)
