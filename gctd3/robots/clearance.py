"""How far parts of a robot in a pose are above the ground, which may be a height field."""

from __future__ import annotations

import mujoco
import numpy as np

from gctd3.robots.geometry import geom_points
from gctd3.robots.ground import can_collide, geoms_of


def placed(model: mujoco.MjModel, qpos: np.ndarray) -> mujoco.MjData:
    """Return the places of all parts in a pose ``[nq]``."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    return data


def foot_points(model: mujoco.MjModel, data: mujoco.MjData, body: int, floor: int) -> np.ndarray:
    """Return points on the geoms of a body that can touch the floor, shape ``[K, 3]`` (m)."""
    parts = [geom_points(model, data, g) for g in geoms_of(model, body) if can_collide(model, g, floor)]
    return np.concatenate(parts) if parts else np.zeros((0, 3))


def sole(model: mujoco.MjModel, data: mujoco.MjData, body: int, floor: int, thickness: float) -> np.ndarray:
    """Return the middle of the lowest part of a foot, shape ``[3]`` (m); its origin if it cannot touch the floor.

    Args:
        model: The model.
        data: Places of all parts, see :func:`placed`.
        body: The foot.
        floor: The geom on which it stands.
        thickness: Height of that part (m).
    """
    points = foot_points(model, data, body, floor)
    if not len(points):
        return np.array(data.xpos[body])
    return np.asarray(points[points[:, 2] < points[:, 2].min() + thickness].mean(axis=0))


def clearance(model: mujoco.MjModel, data: mujoco.MjData, body: int, floor: int) -> float:
    """Return how far the lowest point of a body is above the floor (m)."""
    points = foot_points(model, data, body, floor)
    if not len(points):
        return np.inf
    if int(model.geom_type[floor]) == int(mujoco.mjtGeom.mjGEOM_HFIELD):
        return float((points[:, 2] - _terrain(model, data, floor, points[:, :2])).min())
    thick = model.geom_size[floor, 2] if int(model.geom_type[floor]) == int(mujoco.mjtGeom.mjGEOM_BOX) else 0.0
    return float(points[:, 2].min() - data.geom_xpos[floor, 2] - thick)


def _terrain(model: mujoco.MjModel, data: mujoco.MjData, floor: int, places: np.ndarray) -> np.ndarray:
    """Return the height of a height field at places ``[K, 2]`` (m)."""
    index = int(model.geom_dataid[floor])
    rows, columns = int(model.hfield_nrow[index]), int(model.hfield_ncol[index])
    start = int(model.hfield_adr[index])
    heights = model.hfield_data[start : start + rows * columns].reshape(rows, columns)
    half, centre = model.hfield_size[index], data.geom_xpos[floor]
    local = (places - centre[:2]) @ data.geom_xmat[floor].reshape(3, 3)[:2, :2]
    column = np.clip((local[:, 0] / half[0] + 1) / 2 * (columns - 1), 0, columns - 1)
    row = np.clip((local[:, 1] / half[1] + 1) / 2 * (rows - 1), 0, rows - 1)
    c, r = np.minimum(column.astype(int), columns - 2), np.minimum(row.astype(int), rows - 2)
    x, y = column - c, row - r
    blended = (heights[r, c] * (1 - x) + heights[r, c + 1] * x) * (1 - y)
    blended += (heights[r + 1, c] * (1 - x) + heights[r + 1, c + 1] * x) * y
    return np.asarray(centre[2] + half[2] * blended)
