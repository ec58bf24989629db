"""The corners of meshes that MuJoCo does not read: COLLADA files and STL files of text."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

from gctd3.errors import RobotError, one_line

_COLLADA = {"c": "http://www.collada.org/2005/11/COLLADASchema"}
_UP = {"X_UP": [[0, -1, 0], [1, 0, 0], [0, 0, 1]], "Y_UP": [[1, 0, 0], [0, 0, -1], [0, 1, 0]], "Z_UP": np.eye(3)}


def is_text_stl(file: Path) -> bool:
    """Tell whether a mesh is an STL of text, which MuJoCo does not read."""
    with file.open("rb") as stream:
        start = stream.read(512)
    return file.suffix.lower() == ".stl" and start.lstrip().startswith(b"solid") and b"facet" in start


def mesh_points(file: Path) -> np.ndarray:
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
