"""Feet that are but a geom of a shank: each gets a body of its own, so that kneeling is not standing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from gctd3.robots.draft import Draft
from gctd3.robots.geometry import geom_points
from gctd3.robots.ground import can_collide, geoms_of

_ANKLE = 0.15  # of the robot's height: a body that is moved from higher up is a shank rather than a foot
_NEAR = 0.05  # of the robot's height: how far above the ground a foot's geom may end
# What a geom is, without where it is.
_ATTRIBUTES = [
    "name",
    "type",
    "size",
    "contype",
    "conaffinity",
    "condim",
    "priority",
    "friction",
    "solmix",
    "solref",
    "solimp",
    "margin",
    "gap",
    "mass",
    "density",
    "typeinertia",
    "fluid_ellipsoid",
    "fluid_coefs",
    "material",
    "rgba",
    "group",
    "hfieldname",
    "meshname",
    "fitscale",
    "userdata",
    "adhesion",
    "surfacevel",
]


def foot_geoms(model: mujoco.MjModel, body: int, floor: int, qpos: np.ndarray, height: float) -> list[int]:
    """Find the geoms of a shank that are its foot; empty if the body is a foot as a whole.

    Args:
        model: The model.
        body: Index of the body at the end of a leg.
        floor: Index of the geom that it stands on.
        qpos: A pose in which the leg stands, shape ``[nq]``.
        height: Height of the robot in that pose (m).
    """
    start, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    if count == 0:
        return []
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    able = [geom for geom in geoms_of(model, body) if can_collide(model, geom, floor)]
    points = {geom: geom_points(model, data, geom) for geom in able}
    spans = {geom: (float(p[:, 2].min()), float(p[:, 2].max())) for geom, p in points.items() if len(p)}
    if len(spans) < 2:
        return []
    ground = min(low for low, _ in spans.values())
    knee = float(data.xanchor[start + count - 1, 2]) - ground
    if knee < _ANKLE * height:
        return []
    small = [g for g, (low, high) in spans.items() if low - ground < _NEAR * height and high - ground < knee / 2]
    return small if len(small) < len(spans) else []


def split_feet(draft: Draft, feet: Sequence[Sequence[int]]) -> list[str]:
    """Move the geoms of each foot into a jointless body below theirs; return the names of these bodies.

    Masses and inertias of the whole stay as they are.

    Args:
        draft: The file.
        feet: Indices of the geoms of each foot, all of one body.
    """
    model, names = draft.model, list[str]()
    draft.edit()
    elements = {geom.id: geom for geom in draft.spec.geoms}
    # Found first: additions change the indices.
    parents = [draft.spec_body(int(model.geom_bodyid[geoms[0]])) for geoms in feet]
    taken = {body.name for body in draft.spec.bodies}
    for parent, geoms in zip(parents, feet, strict=True):
        own = model.geom(geoms[0]).name if len(geoms) == 1 else ""
        name = own or f"{parent.name}_foot"
        while name in taken:
            name += "_foot"
        taken.add(name)
        names.append(name)
        foot = parent.add_body(name=name, pos=model.geom_pos[geoms[0]].copy())
        for geom in geoms:
            _move(draft, elements[geom], geom, foot, bool(parent.explicitinertial))
        for exclude in list(draft.spec.excludes):
            if parent.name in (exclude.bodyname1, exclude.bodyname2):
                other = exclude.bodyname2 if exclude.bodyname1 == parent.name else exclude.bodyname1
                draft.spec.add_exclude(bodyname1=name, bodyname2=other)
    draft.compile()
    return names


def _move(draft: Draft, old: mujoco.MjsGeom, index: int, foot: mujoco.MjsBody, massless: bool) -> None:
    """Move one geom into the new body, in which its place is relative to the body's."""
    spec, model = draft.spec, draft.model
    values: dict[str, Any] = {}
    for name in _ATTRIBUTES:
        value = getattr(old, name)
        values[name] = np.array(value) if hasattr(value, "__len__") and not isinstance(value, str) else value
    pos, quat = model.geom_pos[index] - np.array(foot.pos), model.geom_quat[index].copy()
    if values["type"] == mujoco.mjtGeom.mjGEOM_MESH:
        # MuJoCo moves a mesh to its centre and turns it to its main axes; the file's place is before that.
        offset, turn = model.mesh_pos[model.geom_dataid[index]], model.mesh_quat[model.geom_dataid[index]]
        inverse, shift = np.zeros(4), np.zeros(3)
        mujoco.mju_negQuat(inverse, turn)
        unturned = np.zeros(4)
        mujoco.mju_mulQuat(unturned, quat, inverse)
        mujoco.mju_rotVecQuat(shift, offset, unturned)
        pos, quat = pos - shift, unturned
    else:
        values["size"], values["meshname"] = model.geom_size[index].copy(), ""
    if massless:
        # The body's own inertial counts it already.
        values["mass"] = 0.0
    values["name"] = old.name
    spec.delete(old)
    new = foot.add_geom(pos=pos, quat=quat)
    for name, value in values.items():
        setattr(new, name, value)
