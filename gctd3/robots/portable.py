"""A completed robot as an MJCF that needs no other file than its own meshes and heightfields.

Visual meshes, skins and pictures are left out. MuJoCo writes an MJCF with six digits, so that numbers are kept beside
it (:mod:`.own_copy`) and only what is read from the MJCF alone is written whole here.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

from gctd3.files import checksum
from gctd3.robots.physics import solid_geoms

# Settings of the compiler that act on what is compiled already, or say where files are.
_SETTLED = (
    *("meshdir", "texturedir", "assetdir", "strippath", "settotalmass", "boundmass", "boundinertia"),
    *("discardvisual", "fusestatic", "inertiagrouprange", "balanceinertia", "inertiafromgeom"),
)
_MESHES = (int(mujoco.mjtGeom.mjGEOM_MESH), int(mujoco.mjtGeom.mjGEOM_SDF))
_UNNAMED = "unnamed\N{SECTION SIGN}"  # begins the names of elements that have none, while they are written
_PICTURES = ("fileright", "fileleft", "fileup", "filedown", "filefront", "fileback", "file")


@dataclass(frozen=True)
class Portable:
    """Hold a completed robot's MJCF.

    Attributes:
        mjcf: The text of the MJCF.
        assets: Files that it names, by that name.
        geoms: Indices of the geoms that it has, in the model that was completed.
        left_out: Files of meshes, skins and pictures that only show the robot.
    """

    mjcf: str
    assets: Mapping[str, Path]
    geoms: tuple[int, ...]
    left_out: tuple[Path, ...] = ()

    @classmethod
    def of(cls, spec: mujoco.MjSpec, model: mujoco.MjModel, folder: Path) -> Portable:
        """Write a compiled spec; elements without a name are given one for a moment.

        Args:
            spec: The spec.
            model: The model that was compiled from it.
            folder: Folder of the robot's file, from which its files are read.
        """
        return _Writing(spec, model, folder).portable()


class Written:
    """Hold a completed spec until a run keeps it: MuJoCo compiles it once more to write it.

    It does not follow its robot into copies and other processes.

    Args:
        spec: The spec.
        model: The model that was compiled from it.
        folder: Folder of the robot's file.
    """

    def __init__(self, spec: mujoco.MjSpec, model: mujoco.MjModel, folder: Path) -> None:
        self._made = functools.lru_cache(lambda: Portable.of(spec, model, folder))

    def portable(self) -> Portable:
        """Return the robot's MJCF."""
        return self._made()

    def __reduce__(self) -> tuple[type[None], tuple[()]]:
        return type(None), ()


class _Writing:
    def __init__(self, spec: mujoco.MjSpec, model: mujoco.MjModel, folder: Path) -> None:
        self.spec, self.model, self.folder = spec, model, folder
        self.bodies, self.geoms = _named(spec.bodies[1:]), _named(spec.geoms)
        self.root = ElementTree.fromstring(spec.to_xml())
        self.parents = {child: parent for parent in self.root.iter() for child in parent}
        self.kept = self._needed()
        self.assets: dict[str, Path] = {}
        self.left_out: list[Path] = []

    def portable(self) -> Portable:
        compiler = self.root.find("compiler")
        if compiler is None:
            compiler = ElementTree.Element("compiler")
            self.root.insert(0, compiler)
        for key in _SETTLED:
            compiler.attrib.pop(key, None)
        # Masses are those that were compiled, whatever the geoms that are left.
        compiler.set("inertiafromgeom", "false")
        world = self.root.find("worldbody")
        if world is not None:
            self._write_bodies(world)
            self._write_geoms(world)
        self._write_assets()
        ElementTree.indent(self.root)
        text = ElementTree.tostring(self.root, encoding="unicode") + "\n"
        return Portable(text, self.assets, tuple(sorted(self.kept)), tuple(dict.fromkeys(self.left_out)))

    def _needed(self) -> set[int]:
        """Return the geoms to keep: all but meshes that only show the robot."""
        model = self.model
        shown = {int(g) for g in np.flatnonzero(np.isin(model.geom_type, _MESHES))} - set(solid_geoms(model).tolist())
        of_geom = int(mujoco.mjtObj.mjOBJ_GEOM)
        for kinds, numbers in (
            (model.sensor_objtype, model.sensor_objid),
            (model.sensor_reftype, model.sensor_refid),
            (model.tuple_objtype, model.tuple_objid),
        ):
            shown -= {int(number) for kind, number in zip(kinds, numbers, strict=True) if int(kind) == of_geom}
        return set(range(model.ngeom)) - shown

    def _write_bodies(self, world: ElementTree.Element) -> None:
        """Write each body's mass, which may come from geoms, whole."""
        model = self.model
        for element in world.iter("body"):
            body = self.bodies[element.get("name", "")]
            _rename(element)
            for inertial in element.findall("inertial"):
                element.remove(inertial)
            if model.body_mass[body] > 0:
                about = {
                    "pos": _text(model.body_ipos[body]),
                    "quat": _text(model.body_iquat[body]),
                    "mass": _text([model.body_mass[body]]),
                    "diaginertia": _text(model.body_inertia[body]),
                }
                element.insert(0, ElementTree.Element("inertial", about))

    def _write_geoms(self, world: ElementTree.Element) -> None:
        model = self.model
        for element in list(world.iter("geom")):
            geom = self.geoms[element.get("name", "")]
            _rename(element)
            if geom not in self.kept:
                self.parents[element].remove(element)
            elif int(model.geom_type[geom]) not in _MESHES and "mesh" in element.attrib:
                # A shape that was fitted to a mesh.
                del element.attrib["mesh"]
                element.attrib.pop("fitscale", None)
                element.set("size", _text(model.geom_size[geom]))

    def _write_assets(self) -> None:
        model, assets = self.model, self.root.find("asset")
        if assets is None:
            return
        meshes, fields = ({part.name: part for part in parts} for parts in (self.spec.meshes, self.spec.hfields))
        # Of a class of geoms, too, which may name one for all.
        used = {geom.get("mesh") for geom in self.root.iter("geom")}
        files = _paths(model, "mesh")
        for element in assets.findall("mesh"):
            mesh, file = meshes[element.get("name", "")], files.get(element.get("name", ""))
            if element.get("name") not in used:
                assets.remove(element)
                self.left_out += [self._place(file)] if file else []
                continue
            element.attrib.pop("class", None)
            element.set("scale", _text(mesh.scale))
            if file:
                self._take(element, file)
            elif "vertex" in element.attrib:
                element.set("vertex", _text(np.array(mesh.uservert, dtype=np.float32)))
        files = _paths(model, "hfield")
        for element in assets.findall("hfield"):
            field, file = fields[element.get("name", "")], files.get(element.get("name", ""))
            element.set("size", _text(field.size))
            if file:
                self._take(element, file)
            elif "elevation" in element.attrib:
                rows = np.array(field.userdata, dtype=np.float32).reshape(field.nrow, field.ncol)
                element.set("elevation", _text(rows[::-1].ravel()))
        self._drop_pictures(assets)

    def _take(self, element: ElementTree.Element, file: str) -> None:
        """Let an element name its file as the run keeps it."""
        path = self._place(file)
        # Named by its content: of two of one name MuJoCo gives a process the first for both (findings/).
        name = f"{checksum(path)[:12]}_{path.name}"
        self.assets[name] = path
        element.set("file", name)

    def _drop_pictures(self, assets: ElementTree.Element) -> None:
        model = self.model
        files = {**_paths(model, "tex"), **_paths(model, "skin")}
        gone = set()
        for element in [*assets.findall("texture"), *assets.findall("skin")]:
            if element.tag == "skin" or any(key in element.attrib for key in _PICTURES):
                assets.remove(element)
                gone.add(element.get("name"))
                named = [files.get(element.get("name", "")), *(element.get(key) for key in _PICTURES[:-1])]
                self.left_out += [self._place(name) for name in named if name]
        deformable = self.root.find("deformable")
        for element in [] if deformable is None else deformable.findall("skin"):
            assert deformable is not None
            deformable.remove(element)
        for material in assets.findall("material"):
            if material.get("texture") in gone:
                del material.attrib["texture"]
            for layer in material.findall("layer"):
                if layer.get("texture") in gone:
                    material.remove(layer)

    def _place(self, file: str) -> Path:
        return (self.folder / file).absolute()


def _named(elements: Sequence[mujoco.MjsElement]) -> dict[str, int]:
    """Give every element a name, and return MuJoCo's index of each by it."""
    for element in elements:
        element.name = element.name or f"{_UNNAMED}{element.id}"
    return {element.name: int(element.id) for element in elements}


def _rename(element: ElementTree.Element) -> None:
    """Take away a name that was given for a moment."""
    if element.get("name", "").startswith(_UNNAMED):
        del element.attrib["name"]


def _paths(model: mujoco.MjModel, kind: str) -> dict[str, str]:
    """Return the file of each asset of a kind that has one, by the asset's name."""
    accessor = {"mesh": model.mesh, "hfield": model.hfield, "tex": model.tex, "skin": model.skin}[kind]
    found, text = {}, bytes(model.paths)
    for number, address in enumerate(getattr(model, f"{kind}_pathadr").tolist()):
        if address >= 0:
            found[accessor(number).name] = text[address : text.index(b"\0", address)].decode()
    return found


def _text(values: Sequence[float] | np.ndarray) -> str:
    """Return numbers as an MJCF has them, such that they are read as the same numbers."""
    return " ".join(str(value) for value in np.asarray(values).ravel().tolist()) if len(values) else ""
