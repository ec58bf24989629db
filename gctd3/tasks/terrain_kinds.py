"""Kinds of ground: rough, slopes, stairs, gaps, stepping stones and boxes, each at full difficulty as its settings say.

Sizes of what has vertical faces are rounded to the terrain's cells.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gctd3.errors import ConfigError, check_between
from gctd3.tasks.terrain import Plan, TerrainKind


@dataclass(frozen=True)
class FlatGround(TerrainKind):
    """Leave the ground flat, for comparisons."""

    stepped: ClassVar[bool] = True

    def __call__(self, plan: Plan) -> np.ndarray:
        """Return zeros, shape ``[rows, columns]``."""
        return np.zeros(plan.shape)


@dataclass(frozen=True)
class RoughGround(TerrainKind):
    """Raise and lower the ground at random, evenly distributed at the points of a grid and linear between them.

    Attributes:
        height: Largest height, up and down (m).
        spacing: Distance between the points (m).
    """

    height: float = 0.04
    spacing: float = 0.2

    def __post_init__(self) -> None:
        _check_above(self, "height", "spacing")

    def __call__(self, plan: Plan) -> np.ndarray:
        """Return the heights, shape ``[rows, columns]`` (m)."""
        places = [(axis - axis[0]) / self.spacing for axis in (plan.along, plan.across)]
        counts = [math.floor(place[-1]) + 2 for place in places]
        points = plan.rng.uniform(-1.0, 1.0, counts)
        (row, along), (column, across) = ((np.floor(p).astype(np.int64), p - np.floor(p)) for p in places)
        lines = points[row] * (1.0 - along[:, None]) + points[row + 1] * along[:, None]
        return self.height * plan.difficulty * (lines[:, column] * (1.0 - across) + lines[:, column + 1] * across)


@dataclass(frozen=True)
class Slopes(TerrainKind):
    """Put slopes up and down one after another, with level ground between them.

    Attributes:
        degrees: Angle of the slopes (degrees).
        run: Length of a slope, measured horizontally (m).
        rest: Length of the level ground between them (m).
    """

    degrees: float = 15.0
    run: float = 2.5
    rest: float = 1.0

    def __post_init__(self) -> None:
        _check_above(self, "degrees", "run", "rest")
        check_between(self, 0, 60, "degrees")

    def __call__(self, plan: Plan) -> np.ndarray:
        """Return the heights, shape ``[rows, columns]`` (m)."""
        top = self.run * math.tan(math.radians(self.degrees * plan.difficulty))
        ends = np.cumsum([0.0, self.run, self.rest, self.run, self.rest])
        profile = np.interp(np.maximum(plan.along, 0.0) % ends[-1], ends, [0.0, top, top, 0.0, 0.0])
        return np.broadcast_to(profile[:, None], plan.shape)


@dataclass(frozen=True)
class Stairs(TerrainKind):
    """Put flights of stairs up and down one after another, with landings between them.

    Attributes:
        rise: Height of a step (m).
        tread: Length of a step (m).
        steps: Number of steps of a flight.
        rest: Length of the landings (m).
    """

    stepped: ClassVar[bool] = True

    rise: float = 0.08
    tread: float = 0.3
    steps: int = 5
    rest: float = 1.0

    def __post_init__(self) -> None:
        _check_above(self, "rise", "tread", "rest")
        check_between(self, 1, 1000, "steps")

    def __call__(self, plan: Plan) -> np.ndarray:
        """Return the heights, shape ``[rows, columns]`` (m)."""
        tread, rest = plan.cells(self.tread), plan.cells(self.rest)
        up = np.repeat(np.arange(1, self.steps), tread)
        flight = np.concatenate([up, np.full(tread + rest, self.steps), up[::-1], np.zeros(rest, dtype=np.int64)])
        profile = self.rise * plan.difficulty * flight[np.maximum(plan.rows, 0) % len(flight)]
        return np.broadcast_to(profile[:, None], plan.shape)


@dataclass(frozen=True)
class Gaps(TerrainKind):
    """Cut pits across the lane.

    Attributes:
        width: Length of a pit forward (m).
        every: Distance from the begin of one pit to the next (m).
    """

    stepped: ClassVar[bool] = True

    width: float = 0.25
    every: float = 1.5

    def __post_init__(self) -> None:
        _check_above(self, "width", "every")
        if self.every <= self.width:
            raise ConfigError(f"every must be above width, {self.width:g} m, got {self.every:g}.")

    def __call__(self, plan: Plan) -> np.ndarray:
        """Return 0, and minus the depth in pits, shape ``[rows, columns]`` (m)."""
        every, width = plan.cells(self.every), plan.cells(self.width * plan.difficulty)
        pit = plan.rows % every >= max(1, every - width)
        return np.where(pit[:, None], -plan.depth, np.zeros(plan.shape))


@dataclass(frozen=True)
class SteppingStones(TerrainKind):
    """Leave square stones of the ground, in rows that are shifted against one another, with pits between them.

    Attributes:
        size: Length and width of a stone (m).
        gap: Distance between stones (m).
        height: Largest height of a stone, up and down (m).
    """

    stepped: ClassVar[bool] = True

    size: float = 0.4
    gap: float = 0.15
    height: float = 0.0

    def __post_init__(self) -> None:
        _check_above(self, "size", "gap")
        check_between(self, 0, 10, "height")

    def __call__(self, plan: Plan) -> np.ndarray:
        """Return the stones' heights, and minus the depth between them, shape ``[rows, columns]`` (m)."""
        size, gap = plan.cells(self.size), plan.cells(self.gap * plan.difficulty)
        period, rows = size + gap, np.maximum(plan.rows, 0)
        lines = rows // period
        shifts = plan.rng.integers(period, size=int(lines[-1]) + 1)
        columns = np.arange(plan.shape[1])[None, :] + shifts[lines][:, None]
        heights = plan.rng.uniform(-1.0, 1.0, (len(shifts), int(columns.max()) // period + 1))
        stone = (rows % period < size)[:, None] & (columns % period < size)
        tops = self.height * plan.difficulty * heights[lines[:, None], columns // period]
        return np.where(stone, tops, -plan.depth)


@dataclass(frozen=True)
class Boxes(TerrainKind):
    """Put boxes in the way, to walk around or over.

    Attributes:
        height: Largest height of a box (m); the lowest is half of it.
        share: Area of all boxes by that of the ground; they may overlap.
        sizes: Smallest and largest side of a box (m).
    """

    stepped: ClassVar[bool] = True

    height: float = 0.1
    share: float = 0.1
    sizes: Sequence[float] = (0.2, 0.6)

    def __post_init__(self) -> None:
        _check_above(self, "height", "share")
        check_between(self, 0, 1, "share")
        if len(self.sizes) != 2 or not 0 < self.sizes[0] <= self.sizes[1]:
            raise ConfigError(f"sizes must be [smallest, largest], above 0 m, got {list(self.sizes)}.")

    def __call__(self, plan: Plan) -> np.ndarray:
        """Return 0, and the boxes' heights where they are, shape ``[rows, columns]`` (m)."""
        tops, rng = np.zeros(plan.shape), plan.rng
        first, (rows, columns) = int(np.argmax(plan.along > 0)), plan.shape
        area = ((self.sizes[0] + self.sizes[1]) / 2) ** 2
        count = round(self.share * (rows - first) * columns * plan.cell**2 / area)
        for _ in range(count):
            long, wide = (plan.cells(float(size)) for size in rng.uniform(self.sizes[0], self.sizes[1], 2))
            row, column = int(rng.integers(first, rows)), int(rng.integers(1 - wide, columns))
            box = tops[row : row + long, max(column, 0) : column + wide]
            np.maximum(box, self.height * plan.difficulty * rng.uniform(0.5, 1.0), out=box)
        return tops


def _check_above(settings: object, *names: str) -> None:
    for name in names:
        if not getattr(settings, name) > 0:
            raise ConfigError(f"{name} must be above 0, got {getattr(settings, name)}.")
