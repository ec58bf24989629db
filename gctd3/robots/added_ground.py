"""The ground that a robot's file lacks: a level plane, added before or after the file is compiled."""

from __future__ import annotations

import mujoco
import numpy as np

from gctd3.errors import RobotError
from gctd3.robots.draft import Draft
from gctd3.robots.ground import add_floor, find_floor, geoms_of, missing_geoms, touching_bodies
from gctd3.robots.mjcf import bodies_below


def prepare_ground(spec: mujoco.MjSpec) -> list[str]:
    """Add a floor to a file that has nothing of the kind, before it is compiled; return the notes.

    Parts of scenes may lack the very floor that their pairs and sensors name.
    """
    types = mujoco.mjtGeom
    grounds = [g for g in spec.geoms if g.type in (types.mjGEOM_PLANE, types.mjGEOM_HFIELD)]
    if grounds or any(g.type == types.mjGEOM_BOX for g in spec.worldbody.geoms):
        return []
    missing, notes = missing_geoms(spec), list[str]()
    if len(missing) > 1:
        return []
    contype, conaffinity = 1, 1
    if not spec.pairs and not any(g.contype or g.conaffinity for g in spec.geoms):
        # Its scene would name what may touch; by custom these groups are not drawn but for collisions.
        solid = [g for g in spec.geoms if g.group >= 3]
        for geom in solid:
            geom.conaffinity = 1
        conaffinity = 0
        if solid:
            notes.append("No geom of the file can touch anything; those of group 3 and above touch the ground now.")
    else:
        for geom in spec.geoms:
            contype, conaffinity = contype | int(geom.conaffinity), conaffinity | int(geom.contype)
    name = add_floor(spec, missing[0] if missing else "floor", contype, conaffinity)
    return [f"The file has no ground; a level plane {name!r} at z = 0 is added.", *notes]


def complete_ground(draft: Draft) -> int:
    """Return the index of the floor, which is added if there is none."""
    floor = find_floor(draft.model, draft.root)
    if floor is not None:
        if not draft.model.geom(floor).name:
            element = next(geom for geom in draft.spec.geoms if geom.id == floor)
            element.name = "floor" if "floor" not in {geom.name for geom in draft.spec.geoms} else f"geom_{floor}"
            draft.compile()
        return floor
    model = draft.model
    robot = [geom for body in bodies_below(model, draft.root) for geom in geoms_of(model, body)]
    contype = int(np.bitwise_or.reduce([1, *model.geom_conaffinity[robot]]))
    conaffinity = int(np.bitwise_or.reduce([1, *model.geom_contype[robot]]))
    name = add_floor(draft.spec, contype=contype, conaffinity=conaffinity)
    draft.edit(f"The file has no ground; a level plane {name!r} at z = 0 is added.")
    draft.compile()
    added = geom_index(draft.model, name)
    if not touching_bodies(draft.model, draft.root, added):
        raise RobotError(f"{draft.file} has no foot: no geom of the robot can touch the ground.")
    return added


def geom_index(model: mujoco.MjModel, name: str) -> int:
    """Return the index of the geom of a name."""
    return int(model.geom(name).id)
