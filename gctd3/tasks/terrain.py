"""Terrain: lanes of ground of several kinds and levels, side by side, over which robots are spread.

A kind is a small frozen dataclass with ``__call__``, which returns heights; a kind of your own is a class in your
package and a line of YAML: ``+task.terrain.kinds.mine._target_=my_package.Mine``. Curricula over levels are those of
Rudin et al. 2022 (arXiv:2109.11978).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from gctd3.errors import ConfigError, check_between, check_seed
from gctd3.tasks.term_checks import check_mapping

BYTES = 12  # of a height: MuJoCo keeps it in single precision, the task in double
MEBIBYTE = 2**20


@dataclass(frozen=True)
class Plan:
    """Hold what a kind of ground is made from.

    Attributes:
        along: Place of each row of heights forward from the end of the flat start, shape ``[rows]`` (m).
        across: Place of each column to the left of the lane's middle, shape ``[columns]`` (m).
        cell: Distance between the heights (m).
        difficulty: Share of the full difficulty, above 0 and at most 1.
        depth: Depth of pits (m): a height of ``-depth`` is one.
        rng: Generator of this lane's own.
    """

    along: np.ndarray
    across: np.ndarray
    cell: float
    difficulty: float
    depth: float
    rng: np.random.Generator

    @property
    def shape(self) -> tuple[int, int]:
        """Return the number of rows and columns."""
        return len(self.along), len(self.across)

    @property
    def rows(self) -> np.ndarray:
        """Return the number of each row of cells from the end of the flat start, shape ``[rows]``."""
        return np.floor(self.along / self.cell + 1e-6).astype(np.int64)

    def cells(self, length: float) -> int:
        """Return a length as a number of cells, at least one."""
        return max(1, round(length / self.cell))


@dataclass(frozen=True)
class TerrainKind(ABC):
    """Compute the heights of one kind of ground.

    Class attributes:
        stepped: Whether each height is that of a cell, with vertical faces between cells, made of boxes; else of a
            vertex, with triangles between them, of a heightfield.
    """

    stepped: ClassVar[bool] = False

    @abstractmethod
    def __call__(self, plan: Plan) -> np.ndarray:
        """Return the heights, shape ``[rows, columns]`` (m); those of the flat start (``along <= 0``) are not used."""


@dataclass(frozen=True)
class Terrain:
    """Hold the settings of the terrain. Each kind has a lane for each level, on which robots start on flat ground.

    Level ``l`` of ``L`` has the share ``(l + 1) / L`` of the full difficulty. A robot of a training begins each episode
    on a kind drawn at random and on its own level of that kind: one higher after an episode in which it got
    :attr:`climb` m far, one lower after one in which it got less than :attr:`drop` m. Without a curriculum, and in
    evaluations, robots are spread evenly over all lanes.

    Attributes:
        kinds: Kinds of ground by name; ``None`` leaves one out.
        levels: Number of levels of each kind.
        length: Length of a lane forward of where robots start (m).
        behind: Its length behind them (m).
        width: Its width (m).
        flat: Length of the flat ground in front of where robots start (m).
        cell: Size of the cells of which boxes are made (m).
        mesh: Cells between the vertices of heightfields. A foot on a finer one has more contacts, which cost most of
            the time of a step.
        depth: Depth of pits, and of the floor around the lanes (m).
        sideways: Largest distance of starts from the middle of a lane (m); 0 where the base cannot move sideways.
        seed: Seed of the heights: equal seeds give equal ground.
        memory: Largest memory of all heights (MiB).
        curriculum: Whether robots of a training climb levels.
        climb: Distance after which a robot is moved one level up (m).
        drop: Distance below which it is moved one level down (m).
    """

    kinds: Mapping[str, TerrainKind | None] = field(default_factory=dict)
    levels: int = 5
    length: float = 17.0
    behind: float = 2.0
    width: float = 3.0
    flat: float = 1.0
    cell: float = 0.05
    mesh: int = 2
    depth: float = 1.0
    sideways: float = 0.5
    seed: int = 0
    memory: float = 64.0
    curriculum: bool = True
    climb: float = 8.0
    drop: float = 2.0

    def __post_init__(self) -> None:
        check_mapping("kinds", self.kinds)
        for name, kind in self.kinds.items():
            if kind is not None and not isinstance(kind, TerrainKind):
                raise ConfigError(
                    f"kinds.{name} must be null or a mapping whose _target_ is a TerrainKind, got {kind!r}."
                )
        if not self.used:
            raise ConfigError("kinds must hold at least one kind of ground, got none; terrain=null is the plane.")
        check_between(self, 1, 1000, "levels", "length", "width", "mesh")
        check_between(self, 0, 1000, "behind", "flat", "sideways", "climb", "drop")
        for name in ("cell", "depth", "memory"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} must be above 0, got {getattr(self, name)}.")
        check_seed("seed", self.seed)
        if self.flat >= self.length:
            raise ConfigError(f"flat must be below length, {self.length:g} m, got {self.flat:g}.")
        if self.sideways > self.width / 2:
            raise ConfigError(f"sideways must be at most half of width, {self.width / 2:g} m, got {self.sideways:g}.")
        if self.cell * self.mesh > self.width / 2:
            most = self.width / 2 / self.mesh
            raise ConfigError(f"cell * mesh must be at most half of width: cell at most {most:g} m, got {self.cell:g}.")
        if self.drop > self.climb:
            raise ConfigError(f"drop must be at most climb, {self.climb:g} m, got {self.drop:g}.")
        rows, columns = self.shape
        # Those of a heightfield are fewer, in an array of the same size.
        needed = BYTES * self.lanes * (rows + 1) * (columns + 1) / MEBIBYTE
        if needed > self.memory:
            finest = self.cell * (needed / self.memory) ** 0.5
            raise ConfigError(
                f"cell must be at least about {finest:.2g} m for {self.lanes} lanes of {self.length + self.behind:g} x "
                f"{self.width:g} m within memory={self.memory:g} MiB, got {self.cell:g}, which takes {needed:,.0f} MiB."
            )

    @property
    def used(self) -> dict[str, TerrainKind]:
        """Return the kinds that are not left out."""
        return {name: kind for name, kind in self.kinds.items() if kind is not None}

    @property
    def lanes(self) -> int:
        """Return the number of lanes: those of a kind follow one another by level."""
        return len(self.used) * self.levels

    @property
    def shape(self) -> tuple[int, int]:
        """Return the number of cells of a lane, forward and to the left; whole meshes."""
        sides, mesh = (self.length + self.behind, self.width), self.cell * self.mesh
        along, across = (round(side / mesh) * self.mesh for side in sides)
        return along, across

    def spacing(self, stepped: bool) -> float:
        """Return the distance between the heights of a kind with steps, or of a heightfield (m)."""
        return self.cell if stepped else self.cell * self.mesh

    @property
    def start(self) -> np.ndarray:
        """Return where robots start in a lane, from its corner, shape ``[2]`` (m)."""
        return np.array([self.behind, self.shape[1] * self.cell / 2])

    def heights(self, name: str, level: int) -> np.ndarray:
        """Return the heights of a lane: one for each cell, or for each vertex of a heightfield (m).

        Raises:
            ConfigError: If the kind returns something else, or heights below the pits.
        """
        kind, shape = self.used[name], self.shape
        more, middle, spacing = (0, 0.5, self.cell) if kind.stepped else (1, 0.0, self.cell * self.mesh)
        rows, columns = (round(side * self.cell / spacing) + more for side in shape)
        along = (np.arange(rows) + middle) * spacing - self.behind - self.flat
        across = (np.arange(columns) + middle) * spacing - shape[1] * self.cell / 2
        # Of its own for each lane: other kinds, and more levels, leave a lane as it is but for its difficulty.
        rng = np.random.default_rng([self.seed, level, *name.encode()])
        plan = Plan(along, across, spacing, (level + 1) / self.levels, self.depth, rng)
        values = np.asarray(kind(plan), dtype=np.float64)
        if values.shape != plan.shape or not np.isfinite(values).all():
            raise ConfigError(
                f"task.terrain.kinds.{name} must return finite heights of shape {list(plan.shape)}, got "
                f"{list(values.shape)}."
            )
        values = np.where(along[:, None] <= 1e-9, 0.0, values)
        if values.min() < -self.depth or (not kind.stepped and values.min() == -self.depth):
            raise ConfigError(
                f"task.terrain.kinds.{name} has heights down to {values.min():.3g} m: task.terrain.depth must be more, "
                f"got {self.depth:g} m."
            )
        return values
