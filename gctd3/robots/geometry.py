"""The shapes of a robot's geoms: points on their surfaces, how low they reach, and their outlines. Lengths in m."""

from __future__ import annotations

import mujoco
import numpy as np

_RING = 24  # points around a round shape
_ANGLES = 2 * np.pi * np.arange(_RING) / _RING
_CIRCLE = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)
# Meridians, poles included: the lowest point is exact.
_SPHERE = np.concatenate(
    [_CIRCLE[:, :1] * [[np.cos(a), np.sin(a), 0.0]] + _CIRCLE[:, 1:] * [[0.0, 0.0, 1.0]] for a in _ANGLES[: _RING // 2]]
)
_CORNERS = np.array(np.meshgrid((-1, 1), (-1, 1), (-1, 1))).reshape(3, -1).T.astype(float)


def geom_points(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> np.ndarray:
    """Return world-frame points whose convex hull is the geom's (a mesh by its convex hull), shape ``[K, 3]`` (m).

    ``data`` must hold the geom's pose (``mj_kinematics``). Planes and height fields have no points.
    """
    kind, size = int(model.geom_type[geom]), model.geom_size[geom]
    centre, turn = data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3)
    types = mujoco.mjtGeom
    if kind in (types.mjGEOM_PLANE, types.mjGEOM_HFIELD):
        return np.zeros((0, 3))
    # Spheres look the same from every side, so that their points may stay in the world's frame.
    if kind == types.mjGEOM_SPHERE:
        return centre + size[0] * _SPHERE
    if kind == types.mjGEOM_CAPSULE:
        ends = np.stack([centre + turn[:, 2] * size[1], centre - turn[:, 2] * size[1]])
        return np.asarray((ends[:, None] + size[0] * _SPHERE[None]).reshape(-1, 3))
    if kind == types.mjGEOM_CYLINDER:
        rims = [np.insert(size[0] * _CIRCLE, 2, end, axis=1) for end in (-size[1], size[1])]
        local = np.concatenate(rims)
    elif kind == types.mjGEOM_ELLIPSOID:
        local = size * _SPHERE
    elif kind == types.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        start = int(model.mesh_vertadr[mesh])
        local = model.mesh_vert[start : start + int(model.mesh_vertnum[mesh])]
    elif kind == types.mjGEOM_BOX:
        local = size * _CORNERS
    else:
        box = model.geom_aabb[geom]
        local = box[:3] + box[3:] * _CORNERS
    return np.asarray(centre + local @ turn.T)


def lowest_point(model: mujoco.MjModel, data: mujoco.MjData, geoms: list[int]) -> float:
    """Compute the height of the lowest point of some geoms (m); infinite if they have no points."""
    heights = [points[:, 2].min() for geom in geoms if len(points := geom_points(model, data, geom))]
    return float(min(heights, default=np.inf))


def convex_hull(points: np.ndarray) -> np.ndarray:
    """Compute the corners of the convex hull of points ``[K, 2]``, anticlockwise, shape ``[H, 2]`` (Andrew 1979)."""
    ordered = np.unique(np.round(points, 9), axis=0)
    if len(ordered) < 3:
        return ordered

    def half(sequence: np.ndarray) -> list[np.ndarray]:
        chain: list[np.ndarray] = []
        for point in sequence:
            while len(chain) > 1 and _turn(chain[-2], chain[-1], point) <= 0:
                chain.pop()
            chain.append(point)
        return chain[:-1]

    return np.array(half(ordered) + half(ordered[::-1]))


def _turn(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
