"""The ground of a task's terrain: its height at any place, where robots start on it, and how they climb its levels.

Places are in the frame of the robot's base at the world's origin: along its forward axis and to the left (m).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import mujoco
import numpy as np

from gctd3.errors import ConfigError
from gctd3.robots.robot import Robot
from gctd3.robots.uneven_ground import Lane, RobotOnGround, normalized, put_on
from gctd3.tasks.measurement import Measurement
from gctd3.tasks.terrain import Terrain

Generator = np.random.Generator | np.random.RandomState
Spot = dict[str, np.ndarray]
# Names in the memory: the lane [*], the place from which distances count [*, 2] (m), the farthest distance of the
# episode [*] (m), and the robot's level of each kind [*, K].
LANE, ORIGIN, FARTHEST, LEVELS = (f"terrain.{name}" for name in ("lane", "origin", "farthest", "levels"))
MOST_BOXES = 20_000
_HAIR = 1e-9  # m above the bottom: a pit


class Ground:
    """Represent the terrain under one robot.

    Args:
        settings: The terrain.
        robot: The robot on its own floor.

    Attributes:
        robot: The robot on the terrain.
        names: Names of the kinds.
        beside: Whether lanes lie side by side; else one behind the other, for a base that cannot move sideways.

    Raises:
        ConfigError: If the ground has steps higher than the robot's legs, or needs too many boxes.
        RobotError: If the robot has no level floor, or was made from a compiled model.
    """

    def __init__(self, settings: Terrain, robot: Robot) -> None:
        self.settings, self.names = settings, tuple(settings.used)
        self.beside = "side" in robot.base.coordinates
        self._base = robot.base
        # What only starts depend on leaves the ground as it is.
        made: dict[str, tuple[RobotOnGround, np.ndarray, np.ndarray]] = robot.grounds
        key = repr(replace(settings, sideways=0.0, curriculum=True, climb=0.0, drop=0.0))
        if key not in made:
            made[key] = self._build(robot)
        self.robot, self._stepped, self._heights = made[key]
        rows, columns = settings.shape
        self._size = np.array([rows, columns]) * settings.cell
        self._corners = np.array([self._corner(lane) for lane in range(settings.lanes)])
        standing = robot.base.read(robot.standing_qpos, np.zeros(robot.model.nv))
        self._standing = np.array([float(standing[n][0]) if n in standing else 0.0 for n in ("forward", "side")])
        data = mujoco.MjData(robot.model)
        data.qpos[:] = robot.standing_qpos
        mujoco.mj_kinematics(robot.model, data)
        places = np.array([robot.foot_place(data, foot) for foot in robot.feet]) @ robot.base.frame[:2].T
        # Where the feet stand, from the coordinates of the base, shape [feet, 2].
        self.feet = places - self._standing
        yaw = standing["yaw"][0] if "yaw" in standing else 0.0
        self.feet = turned(self.feet, np.asarray(-yaw))

    def _corner(self, lane: int) -> np.ndarray:
        settings = self.settings
        rows, columns = settings.shape
        number = np.array([0, lane]) if self.beside else np.array([lane, 0])
        middle = np.array([0.0, -columns * settings.cell * (settings.lanes if self.beside else 1) / 2])
        return number * np.array([rows, columns]) * settings.cell + middle - [settings.behind, 0.0]

    def _build(self, robot: Robot) -> tuple[RobotOnGround, np.ndarray, np.ndarray]:
        """Make the lanes; return the robot on them, whether each has steps ``[lanes]``, and heights."""
        settings = self.settings
        rows, columns = settings.shape
        lanes, heights = list[Lane](), np.zeros((settings.lanes, rows + 1, columns + 1))
        stepped = np.zeros(settings.lanes, dtype=bool)
        for lane in range(settings.lanes):
            name, level = self.names[lane // settings.levels], lane % settings.levels
            values = settings.heights(name, level)
            self._check_steps(robot, name, values)
            corner = self._corner(lane)
            if settings.used[name].stepped or np.ptp(values) == 0.0:
                tops = values if settings.used[name].stepped else np.full((rows, columns), values[0, 0])
                stepped[lane], heights[lane, :rows, :columns] = True, tops
                boxes = merged_boxes(tops, settings.cell, -settings.depth)
                lanes.append(Lane(corner, settings.cell, boxes=boxes + np.array([*corner[[0, 0, 1, 1]], 0.0])))
            else:
                # To the last bit as MuJoCo has them.
                shares, lowest, span = normalized(values)
                made = lowest + shares.astype(np.float64) * span
                heights[lane, : len(made), : made.shape[1]] = made
                lanes.append(Lane(corner, settings.spacing(False), heights=values))
        count = sum(len(lane.boxes) for lane in lanes)
        if count > MOST_BOXES:
            raise ConfigError(
                f"task.terrain must need at most {MOST_BOXES:,} boxes, got {count:,}: fewer levels, a coarser cell, or "
                "a kind that is a heightfield."
            )
        return put_on(robot, lanes, -settings.depth), stepped, heights

    def _check_steps(self, robot: Robot, name: str, values: np.ndarray) -> None:
        """Raise a :class:`.ConfigError` if two neighbouring heights outside of pits differ by more than a leg."""
        known = np.where(values <= -self.settings.depth + _HAIR, np.nan, values)
        with np.errstate(invalid="ignore"):
            steps = [np.nanmax(np.abs(np.diff(known, axis=axis)), initial=0.0) for axis in (0, 1)]
        if max(steps) > robot.leg_length:
            raise ConfigError(
                f"task.terrain.kinds.{name} must have no step higher than the robot's legs, {robot.leg_length:.3g} m, "
                f"got {max(steps):.3g} m."
            )

    @property
    def bounds(self) -> np.ndarray:
        """Return the lowest and the highest place of all lanes, shape ``[2, 2]`` (m)."""
        return np.stack([self._corners[0], self._corners[-1] + self._size])

    # Heights.

    def lane_at(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the lane at places ``[*, 2]``, the place within it ``[*, 2]``, and whether there is one ``[*]``."""
        axis = 1 if self.beside else 0
        away = places - self._corners[0]
        lane = np.floor(away[..., axis] / self._size[axis]).astype(np.int64)
        lane = np.clip(lane, 0, self.settings.lanes - 1)
        local = places - self._corners[lane]
        # Rounding may leave a place on the border of two lanes in neither.
        inside = ((local > -_HAIR) & (local < self._size + _HAIR)).all(axis=-1)
        return lane, np.clip(local, 0.0, self._size), inside

    def height(self, places: np.ndarray) -> np.ndarray:
        """Return the height of the ground at places ``[*, 2]``, as a ray from above finds it, shape ``[*]`` (m)."""
        lane, local, inside = self.lane_at(places)
        steps = self._stepped[lane]
        meshes = np.where(steps, 1, self.settings.mesh)
        at = local / (self.settings.cell * meshes)[..., None]
        rows, columns = self.settings.shape
        row = np.minimum(at[..., 0].astype(np.int64), rows // meshes - 1)
        column = np.minimum(at[..., 1].astype(np.int64), columns // meshes - 1)
        near = self._heights[lane, row, column]
        if not steps.all():
            along, across = at[..., 0] - row, at[..., 1] - column
            far = self._heights[lane, row + 1, column + 1]
            forward, left = self._heights[lane, row + 1, column], self._heights[lane, row, column + 1]
            # Of the two triangles of a cell, which meet along the diagonal from its first corner.
            first = near + along * (forward - near) + across * (far - forward)
            second = near + across * (left - near) + along * (far - left)
            near = np.where(steps, near, np.where(along >= across, first, second))
        return np.where(inside, near, -self.settings.depth)

    def level(self, places: np.ndarray) -> np.ndarray:
        """Return the height to walk on at places ``[*, 2]``: that of the ground, and 0 over pits; ``[*]`` (m)."""
        height = self.height(places)
        return np.where(height <= -self.settings.depth + _HAIR, 0.0, height)

    def below(self, places: np.ndarray, yaw: np.ndarray) -> np.ndarray:
        """Return the height of the ground below robots, ``[*]`` (m): the mean of :meth:`level` where feet would stand.

        Args:
            places: Places of the base, shape ``[*, 2]``.
            yaw: Their yaw from standing, shape ``[*]`` (rad).
        """
        feet = places[..., None, :] + turned(self.feet, np.asarray(yaw)[..., None])
        return np.asarray(self.level(feet).mean(axis=-1))

    # Measuring.

    def relative(self, place: dict[str, np.ndarray], spot: Mapping[str, np.ndarray] | None) -> dict[str, np.ndarray]:
        """Count the coordinates of the base from the start of the episode, and from the ground below.

        Args:
            place: Coordinates from standing at the world's origin, each ``[*]``.
            spot: Memory of the episodes; ``None`` for the first lane.
        """
        origin = self.first(place["forward"].shape)[ORIGIN] if spot is None else spot[ORIGIN]
        nothing = np.zeros_like(place["forward"])
        here = np.stack([place["forward"], place.get("side", nothing)], axis=-1) + self._standing
        moved = dict(place)
        moved["forward"] = np.asarray(place["forward"] - origin[..., 0])
        if "side" in place:
            moved["side"] = np.asarray(place["side"] - origin[..., 1])
        moved["height"] = np.asarray(place["height"] - self.below(here, place.get("yaw", nothing)))
        return moved

    def whereabouts(self, now: Measurement, side: np.ndarray, spot: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the places of the base, shape ``[*, 2]``, from the distances of a measurement."""
        return np.stack([now.position, side], axis=-1) + self._standing + spot[ORIGIN]

    # Starts.

    def first(self, shape: tuple[int, ...]) -> Spot:
        """Return the starts of robots on the first lane."""
        levels = np.zeros((*shape, len(self.names)), dtype=np.int64)
        return self._at(np.zeros(shape, dtype=np.int64), np.zeros(shape), levels)

    def draw(self, rng: Generator, shape: tuple[int, ...], last: Mapping[str, np.ndarray] | None) -> Spot:
        """Draw the lanes on which episodes start, and where; see :class:`.Terrain`.

        Args:
            rng: Generator.
            shape: Robots.
            last: Memory at the end of the robots' last episodes; ``None`` for none.
        """
        settings, kinds = self.settings, len(self.names)
        count = int(np.prod(shape, dtype=int))
        levels = self._climbed(last) if last is not None else np.zeros((*shape, kinds), dtype=np.int64)
        if settings.curriculum:
            kind = _integers(rng, kinds, count)
            lane = kind * settings.levels + levels.reshape(count, kinds)[np.arange(count), kind]
        else:
            lane = (int(_integers(rng, settings.lanes, 1)[0]) + np.arange(count)) % settings.lanes
        sideways = settings.sideways if self.beside else 0.0
        away = np.asarray(rng.uniform(-sideways, sideways, count)) if sideways else np.zeros(count)
        return self._at(lane.reshape(shape), away.reshape(shape), levels)

    def _at(self, lane: np.ndarray, away: np.ndarray, levels: np.ndarray) -> Spot:
        origin = self._corners[lane] + self.settings.start
        origin[..., 1] += away
        return {LANE: lane, ORIGIN: origin, FARTHEST: np.zeros(lane.shape), LEVELS: levels}

    def _climbed(self, last: Mapping[str, np.ndarray]) -> np.ndarray:
        settings, levels = self.settings, np.array(last[LEVELS])
        kind, far = last[LANE] // settings.levels, last[FARTHEST]
        change = np.where(far >= settings.climb, 1, np.where(far < settings.drop, -1, 0))
        on = np.arange(len(self.names)) == kind[..., None]
        return np.asarray(np.clip(levels + on * change[..., None], 0, settings.levels - 1))

    def put(self, qpos: np.ndarray, origin: np.ndarray) -> np.ndarray:
        """Move one robot's pose ``[nq]`` from the world's origin to a place ``[2]``."""
        moved, base = qpos.copy(), self._base
        if base.free is not None:
            moved[base.free.qpos : base.free.qpos + 3] += origin @ base.frame[:2]
            return moved
        for name, distance in zip(("forward", "side"), origin, strict=True):
            if name in base.single:
                moved[base.single[name].qpos] += base.single[name].sign * distance
        return moved

    def advance(self, before: Mapping[str, np.ndarray], now: Measurement, side: np.ndarray) -> Spot:
        """Return what the memory holds after a step."""
        far = np.maximum(before[FARTHEST], np.hypot(now.position, side))
        return {name: before[name] for name in (LANE, ORIGIN, LEVELS)} | {FARTHEST: far}

    def describe(self, lane: int) -> tuple[str, int]:
        """Return the kind of a lane, and its level from 1."""
        return self.names[lane // self.settings.levels], lane % self.settings.levels + 1


def turned(points: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """Transform points ``[*, 2]`` by turns to the left, of angles ``[*]`` (rad)."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    x, y = points[..., 0], points[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def merged_boxes(tops: np.ndarray, cell: float, bottom: float) -> np.ndarray:
    """Find few boxes that cover cells: runs of equal height in a row, joined with equal runs of the next rows.

    Args:
        tops: Height of each cell, shape ``[rows, columns]`` (m); a cell at the bottom has no box.
        cell: Size of a cell (m).
        bottom: Height of the bottom (m).

    Returns:
        Begin and end forward, begin and end to the left, and top of each box, shape ``[B, 5]`` (m).
    """
    boxes: list[tuple[float, ...]] = []
    open_runs: dict[tuple[int, int, float], int] = {}
    rows = len(tops)
    for row in range(rows + 1):
        runs: set[tuple[int, int, float]] = set()
        if row < rows and row and (tops[row] == tops[row - 1]).all():
            continue
        if row < rows:
            ends = np.flatnonzero(np.diff(tops[row])) + 1
            for begin, end in zip([0, *ends], [*ends, tops.shape[1]], strict=True):
                if tops[row, begin] > bottom + _HAIR:
                    runs.add((int(begin), int(end), float(tops[row, begin])))
        ended = {run: begin for run, begin in open_runs.items() if run not in runs}
        boxes += [(begin * cell, row * cell, run[0] * cell, run[1] * cell, run[2]) for run, begin in ended.items()]
        open_runs = {run: open_runs.get(run, row) for run in runs}
    return np.array(sorted(boxes)).reshape(-1, 5)


def _integers(rng: Generator, below: int, count: int) -> np.ndarray:
    draw = rng.integers if isinstance(rng, np.random.Generator) else rng.randint
    return np.asarray(draw(0, below, count), dtype=np.int64)
