"""What a robot's URDF or SDF cannot say, listed from its compiled MuJoCo model."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Literal

import mujoco
import numpy as np

from gctd3.robots.actuators import is_position_servo
from gctd3.robots.draft import listed
from gctd3.robots.links import LIGHT, Links
from gctd3.robots.mjcf import bodies_below, body_name, colliding_geoms
from gctd3.robots.robot import Robot

MANY = 12  # names that are listed
Format = Literal["urdf", "sdf"]
# What a URDF has to state and MuJoCo has no limit for: m, N m or N, rad/s or m/s.
FAR, STRONG, FAST = 1e6, 1e6, 1e3


def unsaid(robot: Robot, links: Links, form: Format) -> list[str]:
    """Return a sentence for each thing of a robot that the format has no place for, or that is written otherwise."""
    return [*_joints(robot, links, form), *_servos(robot), *_shapes(robot, form), *_rest(robot, form)]


def _joints(robot: Robot, links: Links, form: Format) -> Iterator[str]:
    model = robot.model
    moving = [joint for joint in links.joints if joint.id >= 0]
    dofs = {joint.name: int(model.jnt_dofadr[joint.id]) for joint in moving}
    armatures = {name: float(model.dof_armature[dof]) for name, dof in dofs.items() if model.dof_armature[dof]}
    if armatures:
        yield (
            f"Armature (rotor inertia, kg m^2) is left out: {_values(armatures)}. Without it explicit servos with much "
            "damping explode at 1 kHz; one can add it to the inertia of the link below the joint, about all three axes."
        )
    light = [link.name for link in links.links if link.body < 0]
    if light:
        yield f"Bodies with several joints are chains of links, of {LIGHT:g} kg each: {listed(light)}."
    empty = [link.name for link in links.links if link.body >= 0 and not model.body_mass[link.body]]
    if empty:
        yield f"Links without mass have {LIGHT:g} kg: {listed(empty)}."
    far = [joint.name for joint in moving if joint.kind == "slide" and np.isinf(joint.upper)]
    if far and form == "urdf":
        yield f"Slides without limits have those of {FAR:g} m: {listed(far)}."
    strong = [joint.name for joint in moving if np.isinf(joint.effort)]
    if strong and form == "urdf":
        yield f"Joints without a limit of effort have {STRONG:g} N m (N): {listed(strong)}."
    if form == "urdf":
        yield f"No joint has a limit of velocity; as URDF needs one, {FAST:g} rad/s (m/s) is written."
    yield "Limits of angles are soft here and hard in most other engines."
    springs = {j.name: float(model.jnt_stiffness[j.id]) for j in moving if model.jnt_stiffness[j.id]}
    if springs and form == "urdf":
        yield f"Springs (N m/rad) are left out: {_values(springs)}."


def _servos(robot: Robot) -> Iterator[str]:
    model = robot.model
    servos = [i for i in robot.actuators if is_position_servo(model, i)]
    if servos:
        names = robot.action_names
        gains = {
            names[k]: f"{model.actuator_gainprm[i, 0]:g} and {-model.actuator_biasprm[i, 2]:g}"
            for k, i in enumerate(robot.actuators)
            if i in servos
        }
        yield f"Position servos, kp (N m/rad) and kd (N m s/rad): {_texts(gains)}."
    others = [model.actuator(i).name or f"actuator {i}" for i in range(model.nu) if i not in servos]
    if others:
        yield f"Actuators that are no position servos: {listed(others)}."


def _shapes(robot: Robot, form: Format) -> Iterator[str]:
    model, kinds = robot.model, mujoco.mjtGeom
    bodies = bodies_below(model, robot.base.root)
    geoms = [g for b in bodies for g in range(model.body_geomadr[b], model.body_geomadr[b] + model.body_geomnum[b])]
    colliding = {g for b in bodies for g in colliding_geoms(model, b)}
    kind = {g: mujoco.mjtGeom(int(model.geom_type[g])) for g in geoms}
    if any(kind[g] == kinds.mjGEOM_CAPSULE for g in geoms):
        yield "Capsules are written as a cylinder and two spheres, which together have the same surface."
    lost = [g for g in colliding if kind[g] in (kinds.mjGEOM_ELLIPSOID, kinds.mjGEOM_SDF, kinds.mjGEOM_HFIELD)]
    if lost:
        yield f"Colliding ellipsoids and the like are left out: {listed(_geoms(model, sorted(lost)))}."
    if any(kind[g] == kinds.mjGEOM_MESH for g in colliding):
        yield "Colliding meshes are STL files beside this one; MuJoCo collides with their convex hulls."
    if any(kind[g] == kinds.mjGEOM_MESH for g in geoms if g not in colliding):
        yield "Meshes that only show the robot are left out."
    own = sorted(colliding)
    if form == "urdf" and own:
        friction = {name: float(model.geom_friction[g, 0]) for name, g in zip(_geoms(model, own), own, strict=True)}
        yield f"Sliding friction of surfaces: {_values(friction)}. Of two, MuJoCo takes the larger."
    if own:
        yield "Which shapes may touch which, and how stiff contacts are (contype, condim, solref, solimp)."


def _rest(robot: Robot, form: Format) -> Iterator[str]:
    model, kinds = robot.model, mujoco.mjtEq
    couplings = [i for i in range(model.neq) if model.eq_type[i] == kinds.mjEQ_JOINT]
    loops = [i for i in range(model.neq) if i not in couplings]
    for equalities, what in ((couplings, "Couplings of joints"), (loops, "Loops of links and other equalities")):
        if equalities:
            names = [model.equality(i).name or f"equality {i}" for i in equalities]
            yield f"{what} are left out: {listed(names)}."
    if model.ntendon:
        yield f"Tendons are left out: {listed([model.tendon(i).name or f'tendon {i}' for i in range(model.ntendon)])}."
    pose = {joint.name: float(robot.standing_qpos[joint.qpos]) for joint in robot.joints}
    yield f"Standing pose (rad): {_values(pose)}."
    if robot.base.free is not None:
        place = robot.standing_qpos[robot.base.free.qpos :][:7]
        numbers = " ".join(f"{value:.6g}" for value in place)
        yield f"Its root {body_name(model, robot.base.root)!r} then is at {numbers} (m, quaternion w x y z)."
    yield "The ground, gravity, sensors and the rate of control are not the robot's."


def _geoms(model: mujoco.MjModel, geoms: Iterable[int]) -> list[str]:
    return [model.geom(g).name or f"geom_{g}" for g in geoms]


def _values(values: dict[str, float]) -> str:
    return _texts({name: f"{value:.6g}" for name, value in values.items()})


def _texts(values: dict[str, str]) -> str:
    """Return values by name, those of one value together."""
    names: dict[str, list[str]] = {}
    for name, value in values.items():
        names.setdefault(value, []).append(name)
    if len(names) == 1 and len(values) > MANY:
        return f"{next(iter(names))} of all {len(values)}"
    return "; ".join(f"{value} of {', '.join(same)}" for value, same in names.items())
