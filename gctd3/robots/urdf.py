"""Read a URDF file for MuJoCo: find its meshes, give it a free base, keep the limits of its joints.

MuJoCo's own reader would fix the base to the world, find no mesh by ``package://``, and make of an effort a limit of
the joint, which slows a saturated servo, instead of one of its servo.
"""

from __future__ import annotations

import glob
import math
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

from gctd3.errors import RobotError, one_line, suggest

_READ_BY_MUJOCO = (".stl", ".obj", ".msh")
_ROOT = re.compile(rb"<\s*([A-Za-z_][\w:.-]*)")
_COLLADA = {"c": "http://www.collada.org/2005/11/COLLADASchema"}
_UP = {"X_UP": [[0, -1, 0], [1, 0, 0], [0, 0, 1]], "Y_UP": [[1, 0, 0], [0, 0, -1], [0, 1, 0]], "Z_UP": np.eye(3)}


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


def collision_meshes(file: Path) -> list[Path]:
    """List the meshes of a URDF's colliding geoms that are found."""
    try:
        root = ElementTree.parse(file).getroot()
    except (OSError, ElementTree.ParseError):
        return []
    paths = (_find_mesh(mesh.get("filename", ""), file) for mesh in root.iterfind("link/collision/geometry/mesh"))
    return [path for path in paths if path is not None]


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
    _check_tree(root, file)
    notes: list[str] = []
    meshes = _take_meshes(root, file, notes)
    _mend_inertias(root, file, notes)
    _fix_massless(root, file, notes)
    _take_the_rest(root, notes)
    _skip_floating_root(root)
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


def _check_tree(root: ElementTree.Element, file: Path) -> None:
    """Check that links and joints have names of their own, and that every joint names two links, no link twice."""
    links = _names(root, "link", file)
    _names(root, "joint", file)
    children, above = dict[str, str](), dict[str, str]()
    for joint in root.iterfind("joint"):
        name = joint.get("name", "")
        parent, child = _end(joint, "parent"), _end(joint, "child")
        for tag, link in (("parent", parent), ("child", child)):
            if link not in links:
                raise RobotError(
                    f"{file}: the {tag} of joint {name!r} must be a link, got {link!r}.{suggest(link, links)}"
                )
        if child in children:
            raise RobotError(
                f"{file}: link {child!r} must be the child of one joint, got {children[child]!r} and {name!r}."
            )
        children[child], above[child] = name, parent
        limit = joint.find("limit")
        for key, text in ({} if limit is None else limit.attrib).items():
            if math.isnan(_number(text)):
                raise RobotError(f"{file}: {key} of joint {name!r} must be a number, got {text!r}.")
    # Each link has one joint above it at most: a way up that does not end goes round.
    for link in links:
        place, seen = link, set[str]()
        while place in above and place not in seen:
            seen.add(place)
            place = above[place]
        if place in seen:
            raise RobotError(f"{file}: links must form a tree; from {place!r} joints lead back to it.")


def _end(joint: ElementTree.Element, tag: str) -> str:
    """Return the link that a joint names as its parent or child; empty if it names none."""
    end = joint.find(tag)
    return "" if end is None else end.get("link", "")


def _names(root: ElementTree.Element, tag: str, file: Path) -> set[str]:
    """Return the names of all links or joints, which must be there and differ."""
    names = set[str]()
    for element in root.iterfind(tag):
        name = element.get("name", "")
        if not name or name in names:
            raise RobotError(
                f"{file}: every {tag} must have a name of its own, got {name!r}{' twice' if name else ''}."
            )
        names.add(name)
    return names


def _number(text: str) -> float:
    """Return the number that a text is; NaN for another text."""
    try:
        return float(text)
    except ValueError:
        return math.nan


# Meshes.


@dataclass(frozen=True)
class _Mesh:
    """A colliding mesh: the link that it is on, its file, its scale, and its place on the link (m, rad)."""

    link: str
    file: Path
    scale: tuple[float, ...]
    xyz: tuple[float, ...]
    rpy: tuple[float, ...]

    def add(self, spec: mujoco.MjSpec, name: str) -> None:
        """Add the mesh to the body of its link."""
        body = spec.body(self.link) or spec.worldbody
        same = [mesh for mesh in spec.meshes if mesh.info == f"{self.file} {self.scale}"]
        if not same:
            mesh = spec.add_mesh(name=name, scale=self.scale, info=f"{self.file} {self.scale}")
            # A thin mesh has no volume of its own.
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
            if self.file.suffix.lower() in _READ_BY_MUJOCO and not _is_text(self.file):
                mesh.file = str(self.file)
            else:
                mesh.uservert = _points(self.file).ravel()
            same = [mesh]
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=same[0].name, pos=self.xyz, quat=_quaternion(self.rpy))


def _take_meshes(root: ElementTree.Element, file: Path, notes: list[str]) -> list[_Mesh]:
    """Take the colliding meshes out of a URDF: MuJoCo's reader would mix up those of the same name."""
    taken, missing, elsewhere = list[_Mesh](), list[str](), set[str]()
    for link in root.iterfind("link"):
        for collision in link.findall("collision"):
            mesh = collision.find("geometry/mesh")
            if mesh is None:
                continue
            name = mesh.get("filename", "")
            path = _find_mesh(name, file)
            if path is None:
                missing.append(name)
                continue
            if path not in _candidates(name, file.absolute()):
                elsewhere.add(name)
            if path.suffix.lower() not in (*_READ_BY_MUJOCO, ".dae"):
                raise RobotError(
                    f"{file}: link {link.get('name')!r} collides as {path}; meshes are .stl, .obj, .msh or .dae."
                )
            origin = collision.find("origin")
            place = {} if origin is None else origin.attrib
            numbers = [
                _numbers(text, file) for text in (mesh.get("scale", "1 1 1"), place.get("xyz"), place.get("rpy"))
            ]
            taken.append(_Mesh(link.get("name", ""), path, *numbers))
            link.remove(collision)
    if missing:
        searched = "the folders above the file, ROS_PACKAGE_PATH, AMENT_PREFIX_PATH and Python's packages"
        where = searched if missing[0].startswith("package://") else file.absolute().parent
        raise RobotError(
            f"{file}: {len(missing)} of its colliding meshes are missing, the first is {missing[0]}, "
            f"looked for in {where}."
        )
    if elsewhere:
        notes.append(
            f"{_some(sorted(elsewhere))} are not where the file says; those of the same name nearby were read."
        )
    hulls = sorted({mesh.file.name for mesh in taken if mesh.file.suffix.lower() == ".dae"})
    if hulls:
        notes.append(f"Of {_some(hulls)} the convex hull was read, which is what collides.")
    return taken


def _find_mesh(name: str, file: Path) -> Path | None:
    """Find a mesh by its name in a URDF."""
    named = next((path for path in _candidates(name, file.absolute()) if path.is_file()), None)
    if named is not None:
        return named
    # Packages move their meshes and leave the names in the file as they were.
    base = re.split(r"[/\\\\]", name)[-1]
    near = {
        path for depth in ("*", "*/*", "../*") for path in file.absolute().parent.glob(f"{depth}/{glob.escape(base)}")
    }
    return min(near) if base and len(near) == 1 else None


def _candidates(name: str, file: Path) -> Iterator[Path]:
    scheme, separator, rest = name.partition("://")
    if not separator:
        yield file.parent / name  # an absolute path stays one
        return
    if scheme == "file":
        yield Path("/" + rest.lstrip("/"))
        return
    package, _, inside = rest.partition("/")
    for folder in file.parents:
        yield folder / package / inside
    for variable, share in (("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")):
        for prefix in filter(None, os.environ.get(variable, "").split(os.pathsep)):
            yield Path(prefix) / share / package / inside
            if Path(prefix).name == package:
                yield Path(prefix) / inside
    spec = find_spec(package) if package.isidentifier() else None
    for place in (spec.submodule_search_locations or []) if spec else []:
        yield Path(place) / inside
    # A package whose folder has another name.
    for folder in file.parents:
        if (folder / "package.xml").is_file():
            yield folder / inside


def _is_text(file: Path) -> bool:
    """Tell whether a mesh is an STL of text, which MuJoCo does not read."""
    with file.open("rb") as stream:
        start = stream.read(512)
    return file.suffix.lower() == ".stl" and start.lstrip().startswith(b"solid") and b"facet" in start


def _points(file: Path) -> np.ndarray:
    """Read the corners of a mesh (m): of a COLLADA file or an STL of text. Shape ``[K, 3]``."""
    try:
        if file.suffix.lower() == ".stl":
            words = re.findall(r"vertex\s+(\S+)\s+(\S+)\s+(\S+)", file.read_text(errors="replace"))
            points = np.array(words, dtype=float).reshape(-1, 3)
        else:
            points = _collada_points(ElementTree.parse(file).getroot())
    except (OSError, ValueError, ElementTree.ParseError, KeyError, AttributeError) as error:
        raise RobotError(f"{file} cannot be read as a mesh: {one_line(error)}.") from error
    if len(points) < 4:
        raise RobotError(f"{file} has no mesh of four corners or more.")
    return np.unique(points, axis=0)


def _collada_points(root: ElementTree.Element) -> np.ndarray:
    """Read the corners of all geometries of a COLLADA file in its scene (m, z up)."""
    clouds: dict[str, np.ndarray] = {}
    for geometry in root.iterfind(".//c:geometry", _COLLADA):
        sources = {f"#{source.get('id')}": source for source in geometry.iterfind("c:mesh/c:source", _COLLADA)}
        for entry in geometry.iterfind("c:mesh/c:vertices/c:input[@semantic='POSITION']", _COLLADA):
            values = sources[entry.attrib["source"]].findtext("c:float_array", "", _COLLADA)
            clouds[f"#{geometry.get('id')}"] = np.array(values.split(), dtype=float).reshape(-1, 3)
    placed: list[np.ndarray] = []

    def walk(node: ElementTree.Element, above: np.ndarray) -> None:
        place = above
        for step in node:
            place = place @ _collada_step(step)
        shown = [clouds[instance.attrib["url"]] for instance in node.iterfind("c:instance_geometry", _COLLADA)]
        placed.extend(cloud @ place[:3, :3].T + place[:3, 3] for cloud in shown)
        for child in node.iterfind("c:node", _COLLADA):
            walk(child, place)

    for node in root.iterfind("c:library_visual_scenes/c:visual_scene/c:node", _COLLADA):
        walk(node, np.eye(4))
    points = np.concatenate(placed or list(clouds.values()) or [np.zeros((0, 3))])
    unit, up = root.find("c:asset/c:unit", _COLLADA), root.findtext("c:asset/c:up_axis", "Z_UP", _COLLADA)
    metres = 1.0 if unit is None else float(unit.get("meter", "1"))
    return metres * points @ np.array(_UP[up.strip()], dtype=float).T


def _collada_step(step: ElementTree.Element) -> np.ndarray:
    """Return the change of place ``[4, 4]`` that an element of a node asks for."""
    kind, change = step.tag.rpartition("}")[2], np.eye(4)
    if kind not in ("matrix", "translate", "rotate", "scale"):
        return change
    values = np.array((step.text or "").split(), dtype=float)
    if kind == "matrix":
        return values.reshape(4, 4)
    if kind == "translate":
        change[:3, 3] = values
    elif kind == "scale":
        change[:3, :3] = np.diag(values)
    else:
        quat, turned = np.zeros(4), np.zeros(9)
        mujoco.mju_axisAngle2Quat(quat, values[:3], np.deg2rad(values[3]))
        mujoco.mju_quat2Mat(turned, quat)
        change[:3, :3] = turned.reshape(3, 3)
    return change


def _quaternion(rpy: tuple[float, ...]) -> np.ndarray:
    """Return the quaternion of a roll, then a pitch, then a yaw about fixed axes (rad)."""
    quat = np.zeros(4)
    mujoco.mju_euler2Quat(quat, np.array(rpy), "XYZ")
    return quat


# The rest of the file.


def _mend_inertias(root: ElementTree.Element, file: Path, notes: list[str]) -> None:
    """Make inertias that no body can have possible: raise moments of 0 or less to a millionth of the largest."""
    mended = []
    for link in root.iterfind("link"):
        inertia = link.find("inertial/inertia")
        if inertia is None:
            continue
        keys = (("ixx", "ixy", "ixz"), ("ixy", "iyy", "iyz"), ("ixz", "iyz", "izz"))
        try:
            values, axes = np.linalg.eigh([[float(inertia.get(key, "0")) for key in row] for row in keys])
        except ValueError as error:
            raise RobotError(
                f"{file}: the inertia of link {link.get('name')!r} is no number: {one_line(error)}."
            ) from error
        if values[-1] > 0.0 and values[0] <= 0.0:
            possible = axes @ np.diag(np.maximum(values, 1e-6 * values[-1])) @ axes.T
            for row, numbers in zip(keys, possible, strict=True):
                for key, number in zip(row, numbers, strict=True):
                    inertia.set(key, repr(float(number)))
            mended.append(link.get("name", ""))
    if mended:
        notes.append(f"The inertia of {_some(mended)} is impossible (not positive) and was raised a little.")


def _fix_massless(root: ElementTree.Element, file: Path, notes: list[str]) -> None:
    """Fix joints that move no mass, and give a little mass to moving links between others."""
    masses = {link.get("name", ""): link.find("inertial/mass") for link in root.iterfind("link")}
    try:
        heavy = {name for name, mass in masses.items() if mass is not None and float(mass.get("value", "0")) > 0.0}
    except ValueError as error:
        raise RobotError(f"{file}: the mass of a link is no number: {one_line(error)}.") from error
    if not heavy:
        raise RobotError(f"{file}: no link has a mass (<inertial> with <mass>).")
    below: dict[str, list[ElementTree.Element]] = {}
    for joint in root.iterfind("joint"):
        below.setdefault(_end(joint, "parent"), []).append(joint)

    def child(joint: ElementTree.Element) -> str:
        return _end(joint, "child")

    def has_mass(link: str, rigid: bool, seen: frozenset[str] = frozenset()) -> bool:
        """Tell whether a link has a mass, or one below it; with ``rigid`` only those fixed to it count."""
        inner = (joint for joint in below.get(link, []) if not rigid or joint.get("type") == "fixed")
        return link in heavy or any(
            has_mass(child(joint), rigid, seen | {link}) for joint in inner if child(joint) not in seen
        )

    fixed, lifted = list[str](), list[str]()
    for joint in root.iterfind("joint"):
        if joint.get("type") == "fixed" or not child(joint):
            continue
        if not has_mass(child(joint), rigid=False):
            joint.set("type", "fixed")
            for tag in ("mimic", "limit", "dynamics"):
                for element in joint.findall(tag):
                    joint.remove(element)
            fixed.append(joint.get("name", ""))
        elif not has_mass(child(joint), rigid=True):
            link = next(link for link in root.iterfind("link") if link.get("name") == child(joint))
            for element in link.findall("inertial"):
                link.remove(element)
            inertial = ElementTree.SubElement(link, "inertial")
            ElementTree.SubElement(inertial, "mass", value="0.001")
            small = dict.fromkeys(("ixx", "iyy", "izz"), "1e-6") | dict.fromkeys(("ixy", "ixz", "iyz"), "0")
            ElementTree.SubElement(inertial, "inertia", small)
            lifted.append(child(joint))
    if fixed:
        notes.append(f"{_some(fixed)} move nothing that has a mass and were fixed.")
    if lifted:
        notes.append(f"{_some(lifted)} move and have no mass: they were given 1 g.")


def _take_the_rest(root: ElementTree.Element, notes: list[str]) -> None:
    """Take out parts for pictures and for other programs, and tell MuJoCo how to read the rest."""
    for link in root.iterfind("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
        # Placeholders, which touch nothing; MuJoCo refuses them.
        for collision in link.findall("collision"):
            if any(_is_empty(shape) for shape in collision.iterfind("geometry/*")):
                link.remove(collision)
    for tag in ("material", "transmission", "gazebo", "mujoco"):
        for element in root.findall(tag):
            root.remove(element)
    # Fixed links stay bodies, so that feet keep their names; the inertia of some files is impossible by a rounding.
    options = {"fusestatic": "false", "balanceinertia": "true", "discardvisual": "true"}
    ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", options)
    followers = [joint.get("name", "") for joint in root.iterfind("joint") if joint.find("mimic") is not None]
    if followers:
        notes.append(f"{_some(followers)} follow other joints (mimic), held to them by equality constraints.")


def _is_empty(shape: ElementTree.Element) -> bool:
    """Tell whether a sphere, cylinder, capsule or box has a size of 0."""
    sizes = [text for key in ("radius", "length", "size") for text in shape.get(key, "").split()]
    try:
        return any(float(text) == 0.0 for text in sizes)
    except ValueError:
        return False  # for MuJoCo to say


def _skip_floating_root(root: ElementTree.Element) -> None:
    """Take out a root link without mass that only carries a floating joint: its child is the root then."""
    joints = root.findall("joint")
    floating = [joint for joint in joints if joint.get("type") == "floating"]
    for joint in floating:
        name = _end(joint, "parent")
        # Not by a path of XML, in which a name could hold what ends it.
        above = [other for other in joints if _end(other, "child") == name]
        beside = [other for other in joints if _end(other, "parent") == name]
        link = next((link for link in root.iterfind("link") if link.get("name") == name), None)
        if not above and len(beside) == 1 and link is not None and link.find("inertial") is None:
            root.remove(link)
            root.remove(joint)


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
        notes.append(f"Links that overlap where all angles are 0 do not collide with each other: {_some(pairs, '; ')}.")


def _free(spec: mujoco.MjSpec, root: ElementTree.Element, file: Path, notes: list[str]) -> None:
    """Give the root link a free joint."""
    joints = root.findall("joint")
    below = {child.get("link") for joint in joints for child in joint.iterfind("child")}
    tops = [name for link in root.iterfind("link") if (name := link.get("name", "")) not in below]
    if len(tops) != 1:
        raise RobotError(f"{file}: expected one root link, got {len(tops)}: {_some(tops) if tops else 'none'}.")
    if any(int(joint.type) == mujoco.mjtJoint.mjJNT_FREE for joint in spec.joints):
        return
    bodies = [body for body in spec.worldbody.bodies]
    if len(bodies) != 1:
        raise RobotError(f"{file}: expected one link below the root link {tops[0]!r}, got {len(bodies)}.")
    bodies[0].add_freejoint(name="root")
    notes.append(f"The root link {bodies[0].name!r} moves freely (free joint 'root').")


def _limits(spec: mujoco.MjSpec, root: ElementTree.Element, notes: list[str]) -> dict[str, dict[str, float]]:
    """Take the limits of torque off the joints, for their servos to keep; those of 0 are no limits."""
    by_joint, silent = dict[str, dict[str, float]](), list[str]()
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
    if len(by_joint) > len(silent):
        notes.append("The limits of torque are the servos', not the joints'.")
    if silent:
        notes.append(f"{_some(silent)} state no limit of torque (effort).")
    return {name: limits for name, limits in by_joint.items() if limits}


def _numbers(text: str | None, file: Path) -> tuple[float, ...]:
    try:
        values = tuple(map(float, (text or "0 0 0").split()))
    except ValueError:
        values = ()
    if len(values) != 3:
        raise RobotError(f"{file}: expected three numbers, got {text!r}.")
    return values


def _some(names: list[str], separator: str = ", ") -> str:
    return separator.join(names[:4]) + (
        f"{'' if separator == ', ' else ';'} and {len(names) - 4} more" if len(names) > 4 else ""
    )
