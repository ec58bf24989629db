"""The colliding meshes of a URDF: where their files are, and their places on the links.

A ``package://`` name is looked for in the folders above the file, in the paths of ROS and among Python's packages.
"""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

from gctd3.errors import RobotError
from gctd3.robots.mesh_points import is_text_stl, mesh_points
from gctd3.robots.urdf_tree import first_names

_READ_BY_MUJOCO = (".stl", ".obj", ".msh")


def collision_meshes(file: Path) -> list[Path]:
    """List the meshes of a URDF's colliding geoms that are found."""
    try:
        root = ElementTree.parse(file).getroot()
    except (OSError, ElementTree.ParseError):
        return []
    paths = (_find_mesh(mesh.get("filename", ""), file) for mesh in root.iterfind("link/collision/geometry/mesh"))
    return [path for path in paths if path is not None]


@dataclass(frozen=True)
class CollisionMesh:
    """Hold a colliding mesh: the link that it is on, its file, its scale, and its place on the link (m, rad)."""

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
            if self.file.suffix.lower() in _READ_BY_MUJOCO and not is_text_stl(self.file):
                mesh.file = str(self.file)
            else:
                mesh.uservert = mesh_points(self.file).ravel()
            same = [mesh]
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=same[0].name, pos=self.xyz, quat=_quaternion(self.rpy))


def take_meshes(root: ElementTree.Element, file: Path, notes: list[str]) -> list[CollisionMesh]:
    """Take the colliding meshes out of a URDF: MuJoCo's reader would mix up those of the same name."""
    taken, missing, elsewhere = list[CollisionMesh](), list[str](), set[str]()
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
            taken.append(CollisionMesh(link.get("name", ""), path, *numbers))
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
            f"{first_names(sorted(elsewhere))} are not where the file says; those of the same name nearby were read."
        )
    hulls = sorted({mesh.file.name for mesh in taken if mesh.file.suffix.lower() == ".dae"})
    if hulls:
        notes.append(f"Of {first_names(hulls)} the convex hull was read, which is what collides.")
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


def _quaternion(rpy: tuple[float, ...]) -> np.ndarray:
    """Return the quaternion of a roll, then a pitch, then a yaw about fixed axes (rad)."""
    quat = np.zeros(4)
    mujoco.mju_euler2Quat(quat, np.array(rpy), "XYZ")
    return quat


def _numbers(text: str | None, file: Path) -> tuple[float, ...]:
    try:
        values = tuple(map(float, (text or "0 0 0").split()))
    except ValueError:
        values = ()
    if len(values) != 3:
        raise RobotError(f"{file}: expected three numbers, got {text!r}.")
    return values
