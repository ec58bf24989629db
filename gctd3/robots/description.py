"""Write a robot as URDF or SDF, from its compiled MuJoCo model: masses, inertias, axes and limits are those of it."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

import gctd3
from gctd3.errors import ConfigError
from gctd3.files import write_bytes, write_text
from gctd3.robots.links import WORLD, Link, LinkJoint, Links, Solid
from gctd3.robots.robot import Robot
from gctd3.robots.unsaid import FAR, FAST, STRONG, Format, unsaid

FORMATS: tuple[Format, ...] = ("urdf", "sdf")
SDF_VERSION = "1.6"  # the newest that DART reads
Element = ElementTree.Element


@dataclass(frozen=True)
class Description:
    """Hold a robot's description.

    Attributes:
        text: The URDF or SDF.
        unsaid: A sentence for each thing that the format cannot say.
        meshes: Content of the mesh files, by the name that the text gives them.
    """

    text: str
    unsaid: tuple[str, ...]
    meshes: Mapping[str, bytes] = field(default_factory=dict)

    def write(self, file: Path) -> tuple[Path, ...]:
        """Write the description to a file, and its meshes beside it; return the paths."""
        for name, content in self.meshes.items():
            place = file.parent / name
            place.parent.mkdir(parents=True, exist_ok=True)
            write_bytes(place, content)
        write_text(file, self.text)
        return (file, *(file.parent / name for name in self.meshes))


def describe_robot(robot: Robot, form: Format, stem: str | None = None, armature: float = 0.0) -> Description:
    """Describe a robot as URDF or SDF.

    Args:
        robot: The robot.
        form: Format.
        stem: Name of the file without its ending, after which the folder of meshes is called; the robot's if ``None``.
        armature: Share of each joint's armature that is added to the link below it, see :meth:`.Links.of`.

    Raises:
        RobotError: If it has a ball joint.
        ConfigError: If a name of it is none in XML.
    """
    links = Links.of(robot, armature)
    name = stem or robot.path.stem.strip("<>") or "robot"
    used = [solid.mesh for link in links.links for solid in link.solids if solid.mesh >= 0]
    files = _mesh_files(robot.model, used, f"{name}-meshes")
    sentences = unsaid(robot, links, form)
    writer = _Urdf(files) if form == "urdf" else _Sdf(files)
    root = writer.write(name, links)
    lines = [f"Written by gctd3 {gctd3.__version__} from {robot.path.name}. This format cannot say:", *sentences]
    # XML ends a comment at two hyphens.
    comment = re.sub("-(?=-)", "- ", "\n".join(f"     {line}" for line in lines)[5:])
    root.insert(0, ElementTree.Comment(f" {comment} "))
    ElementTree.indent(root)
    text = '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"
    try:
        ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ConfigError(f"{robot.path} has a name that XML cannot hold: {error}.") from error
    contents = {files[mesh]: _stl(robot.model, mesh) for mesh in dict.fromkeys(used)}
    return Description(text, tuple(sentences), contents)


class _Urdf:
    """Write links and joints as URDF."""

    def __init__(self, files: Mapping[int, str]) -> None:
        self.files = files

    def write(self, name: str, links: Links) -> Element:
        root = Element("robot", name=name)
        if not links.free:
            _add(root, "link", name=WORLD)
        for link in links.links:
            self._link(root, link)
        for joint in links.joints:
            self._joint(root, joint)
        return root

    def _link(self, root: Element, link: Link) -> None:
        element = _add(root, "link", name=link.name)
        inertial = _add(element, "inertial")
        _add(inertial, "origin", xyz=_text(link.centre), rpy="0 0 0")
        _add(inertial, "mass", value=_text(link.mass))
        _add(inertial, "inertia", **{key: _text(value) for key, value in _moments(link.inertia).items()})
        for solid in link.solids:
            for tag in ("visual", "collision") if solid.collides else ("visual",):
                part = _add(element, tag, name=solid.name)
                _add(part, "origin", xyz=_text(solid.position), rpy=_text(angles(solid.rotation)))
                self._shape(_add(part, "geometry"), solid)

    def _shape(self, geometry: Element, solid: Solid) -> None:
        if solid.shape == "box":
            _add(geometry, "box", size=_text(solid.size))
        elif solid.shape == "sphere":
            _add(geometry, "sphere", radius=_text(solid.size[0]))
        elif solid.shape == "cylinder":
            _add(geometry, "cylinder", radius=_text(solid.size[0]), length=_text(solid.size[1]))
        else:
            _add(geometry, "mesh", filename=self.files[solid.mesh])

    def _joint(self, root: Element, joint: LinkJoint) -> None:
        limited = math.isfinite(joint.upper)
        kinds = {"hinge": "revolute" if limited else "continuous", "slide": "prismatic", "fixed": "fixed"}
        element = _add(root, "joint", name=joint.name, type=kinds[joint.kind])
        _add(element, "parent", link=joint.parent)
        _add(element, "child", link=joint.child)
        _add(element, "origin", xyz=_text(joint.position), rpy=_text(angles(joint.rotation)))
        if joint.kind == "fixed":
            return
        _add(element, "axis", xyz=_text(joint.axis))
        limits = {"lower": max(joint.lower, -FAR), "upper": min(joint.upper, FAR)} if limited else {}
        if joint.kind == "slide":
            limits = {"lower": max(joint.lower, -FAR), "upper": min(joint.upper, FAR)}
        limits |= {"effort": min(joint.effort, STRONG), "velocity": FAST}
        _add(element, "limit", **{key: _text(value) for key, value in limits.items()})
        if joint.damping or joint.friction:
            _add(element, "dynamics", damping=_text(joint.damping), friction=_text(joint.friction))


class _Sdf:
    """Write links and joints as SDF, in which a link's place is that in the model, at angles of 0."""

    def __init__(self, files: Mapping[int, str]) -> None:
        self.files = files

    def write(self, name: str, links: Links) -> Element:
        root = Element("sdf", version=SDF_VERSION)
        model = _add(root, "model", name=name)
        places: dict[str, tuple[np.ndarray, np.ndarray]] = {WORLD: (np.zeros(3), np.eye(3))}
        if links.free:
            places[links.links[0].name] = places[WORLD]
        for joint in links.joints:
            at, turn = places[joint.parent]
            places[joint.child] = at + turn @ joint.position, turn @ joint.rotation
        for link in links.links:
            self._link(model, link, *places[link.name])
        for joint in links.joints:
            self._joint(model, joint)
        return root

    def _link(self, model: Element, link: Link, at: np.ndarray, turn: np.ndarray) -> None:
        element = _add(model, "link", name=link.name)
        _pose(element, at, turn)
        inertial = _add(element, "inertial")
        _pose(inertial, link.centre, np.eye(3))
        _add(inertial, "mass").text = _text(link.mass)
        inertia = _add(inertial, "inertia")
        for key, value in _moments(link.inertia).items():
            _add(inertia, key).text = _text(value)
        for solid in link.solids:
            for tag in ("visual", "collision") if solid.collides else ("visual",):
                part = _add(element, tag, name=f"{solid.name}_{tag}")
                _pose(part, solid.position, solid.rotation)
                self._shape(_add(part, "geometry"), solid)
                if tag == "collision":
                    friction = _add(_add(_add(part, "surface"), "friction"), "ode")
                    for direction in ("mu", "mu2"):
                        _add(friction, direction).text = _text(solid.friction)

    def _shape(self, geometry: Element, solid: Solid) -> None:
        shape = _add(geometry, solid.shape)
        if solid.shape == "box":
            _add(shape, "size").text = _text(solid.size)
        elif solid.shape == "mesh":
            _add(shape, "uri").text = self.files[solid.mesh]
        else:
            for key, value in zip(("radius", "length"), solid.size, strict=False):
                _add(shape, key).text = _text(value)

    def _joint(self, model: Element, joint: LinkJoint) -> None:
        kinds = {"hinge": "revolute", "slide": "prismatic", "fixed": "fixed"}
        element = _add(model, "joint", name=joint.name, type=kinds[joint.kind])
        _add(element, "parent").text = joint.parent
        _add(element, "child").text = joint.child
        if joint.kind == "fixed":
            return
        axis = _add(element, "axis")
        _add(axis, "xyz").text = _text(joint.axis)
        limit = _add(axis, "limit")
        # Of no limit SDF says 1e16, of no limit of effort -1.
        _add(limit, "lower").text = _text(max(joint.lower, -1e16))
        _add(limit, "upper").text = _text(min(joint.upper, 1e16))
        _add(limit, "effort").text = _text(joint.effort if math.isfinite(joint.effort) else -1.0)
        dynamics = _add(axis, "dynamics")
        _add(dynamics, "damping").text = _text(joint.damping)
        _add(dynamics, "friction").text = _text(joint.friction)


def angles(rotation: np.ndarray) -> np.ndarray:
    """Return roll, pitch and yaw of a rotation ``Rz(yaw) Ry(pitch) Rx(roll)``, shape ``[3]`` (rad).

    They give the rotation back to the last digits also where pitch is a right angle, which an arc sine does not.
    """
    r = rotation
    yaw = math.atan2(r[1, 0], r[0, 0]) if math.hypot(r[1, 0], r[0, 0]) > 1e-12 else 0.0
    sine, cosine = math.sin(yaw), math.cos(yaw)
    pitch = math.atan2(-r[2, 0], cosine * r[0, 0] + sine * r[1, 0])
    roll = math.atan2(sine * r[0, 2] - cosine * r[1, 2], cosine * r[1, 1] - sine * r[0, 1])
    return np.array([roll, pitch, yaw])


def _add(parent: Element, tag: str, **attributes: str) -> Element:
    return ElementTree.SubElement(parent, tag, attributes)


def _pose(parent: Element, at: np.ndarray, turn: np.ndarray) -> None:
    _add(parent, "pose").text = f"{_text(at)} {_text(angles(turn))}"


def _text(values: float | Sequence[float] | np.ndarray) -> str:
    """Return numbers with all their digits."""
    # A negative zero is a zero.
    return " ".join(repr(float(value) + 0.0) for value in np.atleast_1d(values))


def _moments(inertia: np.ndarray) -> dict[str, float]:
    order = ("ixx", 0, 0), ("ixy", 0, 1), ("ixz", 0, 2), ("iyy", 1, 1), ("iyz", 1, 2), ("izz", 2, 2)
    return {key: float((inertia[i, k] + inertia[k, i]) / 2) for key, i, k in order}


def _mesh_files(model: mujoco.MjModel, meshes: Sequence[int], folder: str) -> dict[int, str]:
    """Return a file for each mesh, by names that any system can hold and that differ."""
    files: dict[int, str] = {}
    for mesh in dict.fromkeys(meshes):
        name = re.sub(r"[^\w.-]", "_", model.mesh(mesh).name) or "mesh"
        files[mesh] = f"{folder}/{name if f'{folder}/{name}.stl' not in files.values() else f'{name}_{mesh}'}.stl"
    return files


def _stl(model: mujoco.MjModel, mesh: int) -> bytes:
    """Return a mesh as a binary STL, in the frame of its geoms (m)."""
    start, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    first, number = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    corners = model.mesh_vert[start : start + count][model.mesh_face[first : first + number]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    rows = np.zeros(number, dtype=[("numbers", "<f4", (4, 3)), ("attribute", "<u2")])
    rows["numbers"][:, 0], rows["numbers"][:, 1:] = normals, corners
    return b"\0" * 80 + struct.pack("<I", number) + rows.tobytes()
