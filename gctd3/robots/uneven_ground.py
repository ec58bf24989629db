"""A robot on ground that is not level: its floor replaced by heightfields and boxes, everything else as it was.

Places are in the frame of the robot's base at the world's origin: along its forward axis, to the left and up (m).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from gctd3.errors import RobotError
from gctd3.robots.ground import find_floor
from gctd3.robots.robot import Robot

_COLOURS = ((0.63, 0.60, 0.55, 1.0), (0.55, 0.58, 0.60, 1.0))  # of lanes in turn, so that their borders are seen
# Numbers that MuJoCo makes of geoms and bodies together, or that depend on their number.
_REMADE = ("mesh_", "hfield_", "skin_", "tex_", "bvh_", "oct_", "flexedge_", "mat_", "names", "paths")


@dataclass(frozen=True)
class Lane:
    """Hold the surface of a rectangle of ground: a heightfield, or boxes.

    Attributes:
        corner: Its lowest place forward and to the left, shape ``[2]`` (m).
        cell: Distance between the heights (m).
        heights: Heights of a heightfield's vertices, shape ``[rows, columns]``: forward, and to the left (m).
        boxes: Boxes, shape ``[B, 5]``: where they begin and end forward, to the left, and their top (m).
    """

    corner: np.ndarray
    cell: float
    heights: np.ndarray | None = None
    boxes: np.ndarray = field(default_factory=lambda: np.zeros((0, 5)))


@dataclass(frozen=True)
class RobotOnGround(Robot):
    """Represent a robot whose model has another ground than its file's; it stands as it does on its own floor.

    Attributes:
        plain: The robot on its own floor.
    """

    plain: Robot | None = None

    @cached_property
    def standing_qpos(self) -> np.ndarray:
        """Return the ``qpos`` of standing on the robot's own floor. Shape ``[nq]``."""
        if self.plain is None:
            raise RobotError(f"{self.path}: a robot on another ground needs the robot on its own floor.")
        return self.plain.standing_qpos


def normalized(heights: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Return heights as MuJoCo keeps those of a heightfield: between 0 and 1 in single precision; lowest, and range.

    Args:
        heights: Heights that are not all equal (m).
    """
    lowest, highest = float(heights.min()), float(heights.max())
    return ((heights - lowest) / (highest - lowest)).astype(np.float32), lowest, highest - lowest


def put_on(robot: Robot, lanes: Sequence[Lane], bottom: float) -> RobotOnGround:
    """Put a robot on uneven ground.

    Its floor is lowered to the bottom of all pits, where it lies around the lanes too. What can touch the floor can
    touch the lanes, with the floor's friction and softness; sensors of contacts with the floor count those with any
    ground.

    Args:
        robot: The robot on its own level floor.
        lanes: The ground.
        bottom: Height of the floor (m); below all lanes.

    Raises:
        RobotError: If the robot has no level floor, or was made from a compiled model, which cannot be added to.
    """
    flat, spec = robot.model, robot.blueprint.spec() if robot.blueprint is not None else None
    if spec is None:
        raise RobotError(f"{robot.path}: terrain is added to a robot's file or MjSpec, and not to a compiled model.")
    floor = find_floor(flat, robot.base.root)
    if floor is None or int(flat.geom_type[floor]) != int(mujoco.mjtGeom.mjGEOM_PLANE):
        raise RobotError(f"{robot.path}: terrain takes the place of a level plane, on which the robot stands; add one.")
    world = int((flat.geom_bodyid == 0).sum())
    geom = spec.worldbody.geoms[floor]
    geom.name = geom.name or "floor_below_terrain"
    height = float(flat.geom_pos[floor, 2])
    geom.pos = [*flat.geom_pos[floor, :2].tolist(), bottom + height]
    names = [name for i, lane in enumerate(lanes) for name in _add(spec, robot, floor, lane, i, bottom, height)]
    _sense_world(spec, geom.name)
    _pair(spec, geom.name, names)
    try:
        model = spec.compile()
    except ValueError as error:
        raise RobotError(f"{robot.path}: MuJoCo cannot compile it with the terrain: {error}") from error
    _copy_numbers(flat, model, world, len(names), floor)
    given = {one.name: getattr(robot, one.name) for one in fields(Robot)}
    return RobotOnGround(**{**given, "model": model, "written": None}, plain=robot)


def _add(
    spec: mujoco.MjSpec, robot: Robot, floor: int, lane: Lane, index: int, bottom: float, height: float
) -> list[str]:
    """Add the geoms of a lane, and return their names."""
    flat, frame = robot.model, robot.base.frame
    turn = np.zeros(4)
    mujoco.mju_mat2Quat(turn, frame.T.ravel())
    alike: dict[str, Any] = {
        "contype": int(flat.geom_contype[floor]),
        "conaffinity": int(flat.geom_conaffinity[floor]),
        "condim": int(flat.geom_condim[floor]),
        "priority": int(flat.geom_priority[floor]),
        "friction": flat.geom_friction[floor].tolist(),
        "solmix": float(flat.geom_solmix[floor]),
        "solref": flat.geom_solref[floor].tolist(),
        "solimp": flat.geom_solimp[floor].tolist(),
        "margin": float(flat.geom_margin[floor]),
        "gap": float(flat.geom_gap[floor]),
        "rgba": list(_COLOURS[index % len(_COLOURS)]),
        "quat": turn.tolist(),
    }
    names: list[str] = []
    if lane.heights is not None:
        names.append(f"terrain_{index}")
        values, lowest, span = normalized(lane.heights)
        half = lane.cell * (np.array(values.shape) - 1) / 2
        # MuJoCo's rows go to the left, its columns forward.
        size = [float(half[0]), float(half[1]), span, lowest - bottom]
        rows, columns = values.T.shape
        spec.add_hfield(name=names[0], nrow=rows, ncol=columns, size=size, userdata=values.T.ravel())
        place = np.array([*(lane.corner + half), lowest + height]) @ frame
        spec.worldbody.add_geom(
            name=names[0], type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname=names[0], pos=place.tolist(), **alike
        )
    for number, (begin, end, right, left, top) in enumerate(lane.boxes.tolist()):
        names.append(f"terrain_{index}_{number}")
        place = np.array([(begin + end) / 2, (right + left) / 2, (top + bottom) / 2 + height]) @ frame
        sides = [(end - begin) / 2, (left - right) / 2, (top - bottom) / 2]
        spec.worldbody.add_geom(name=names[-1], type=mujoco.mjtGeom.mjGEOM_BOX, size=sides, pos=place.tolist(), **alike)
    return names


def _sense_world(spec: mujoco.MjSpec, floor: str) -> None:
    """Let the sensors of contacts with the floor count contacts with everything that is fixed to the world."""
    body, geom = mujoco.mjtObj.mjOBJ_BODY, mujoco.mjtObj.mjOBJ_GEOM
    for sensor in spec.sensors:
        if sensor.type != mujoco.mjtSensor.mjSENS_CONTACT:
            continue
        if sensor.objtype == geom and sensor.objname == floor:
            sensor.objtype, sensor.objname = body, "world"
        if sensor.reftype == geom and sensor.refname == floor:
            sensor.reftype, sensor.refname = body, "world"


def _pair(spec: mujoco.MjSpec, floor: str, names: Sequence[str]) -> None:
    """Repeat for each geom the explicit pairs of contacts with the floor."""
    for pair in list(spec.pairs):
        if floor not in (pair.geomname1, pair.geomname2):
            continue
        kept = ("condim", "friction", "solref", "solreffriction", "solimp", "margin", "gap")
        alike = {key: getattr(pair, key) for key in kept}
        for name in names:
            other = pair.geomname2 if pair.geomname1 == floor else pair.geomname1
            spec.add_pair(geomname1=name, geomname2=other, **alike)


def _copy_numbers(flat: mujoco.MjModel, model: mujoco.MjModel, world: int, added: int, floor: int) -> None:
    """Copy every number of the model on its own floor: it may have been changed since it was compiled.

    Geoms of the world come first, so that those of the robot have moved by the number of those that were added.
    """
    for prefix, old, new in (("", flat, model), ("opt.", flat.opt, model.opt), ("stat.", flat.stat, model.stat)):
        for name in dir(old):
            if name.startswith(("_", *_REMADE)):
                continue
            value = getattr(old, name, None)
            if isinstance(value, float) and prefix:
                setattr(new, name, value)
            if not isinstance(value, np.ndarray) or value.dtype.kind != "f":
                continue
            into = getattr(new, name)
            if name.startswith("geom_"):
                own = np.delete(np.arange(world), floor)
                into[own] = value[own]
                into[world + added :] = value[world:]
            elif into.shape == value.shape and not name.startswith("pair_"):
                into[...] = value
