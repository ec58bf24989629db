"""The outlines of feet against their mirror images': how far they reach in 26 directions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gctd3.robots.geometry import geom_points
from gctd3.robots.mirror_messages import millimetres, name_pair
from gctd3.robots.model_reflection import ModelReflection

_CORNERS = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z) != (0, 0, 0)])
_DIRECTIONS = _CORNERS / np.linalg.norm(_CORNERS, axis=1, keepdims=True)


def outline_difference(image: ModelReflection) -> str:
    """Name the foot whose outline differs most from its image's; empty if none does."""
    robot, order = image.robot, image.robot.mirror_feet
    worst, difference = image.rounding, ""
    for i, k in enumerate(order):
        if k < i:
            continue
        points = [_points(image, image.foot_geoms(robot.feet[foot])) for foot in (i, k)]
        if not all(map(len, points)):
            continue
        directions = image.seen(_DIRECTIONS)
        one, two = (image.plane.place(points[0]) @ directions.T).max(axis=0), (points[1] @ directions.T).max(axis=0)
        away = float(np.abs(one - two).max())
        if away > worst:
            pair = name_pair(robot.feet[i], robot.feet[k])
            worst, difference = away, f"the outline of foot {pair}, {millimetres(away)} off"
    return difference


def _points(image: ModelReflection, geoms: Sequence[int]) -> np.ndarray:
    clouds = [geom_points(image.model, image.data, geom) for geom in geoms]
    return np.concatenate(clouds) if clouds else np.zeros((0, 3))
