"""What pictures of a walk show of the terrain: marks that lie on it, where rays meet it, and its name."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from gctd3.tasks.features import Sensed
from gctd3.tasks.ground import LANE, ORIGIN, Ground
from gctd3.tasks.height_scan import HeightScan
from gctd3.tasks.measurement import Measurement
from gctd3.tasks.simulated_task import SimulatedTask

_RAY, _DOT = np.array([0.85, 0.18, 0.15, 1.0], np.float32), 0.012  # colour, and radius (m)
_SAMPLES = 13  # of the ground along a mark


def scans(task: SimulatedTask) -> list[HeightScan]:
    """Return the height scans of a task's policy and critics."""
    features = {**task.settings.features, **task.settings.privileged}
    return [one for one in features.values() if isinstance(one, HeightScan)]


def ray_points(task: SimulatedTask, now: Measurement, memory: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return where the rays of a task's scans meet the terrain, shape ``[rays, 3]`` (m, in the world).

    None without terrain or scan. Of a batch of robots those of the first count.
    """
    if task.ground is None or not (found := scans(task)):
        return np.zeros((0, 3))
    sensed = Sensed(now, memory, task.facts)
    places = np.concatenate([one.places(sensed)[0] for one in found])
    return in_world(task, places, task.ground.height(places))


def in_world(task: SimulatedTask, places: np.ndarray, heights: np.ndarray) -> np.ndarray:
    """Return points of the world ``[*, 3]`` (m) from places ``[*, 2]`` and heights ``[*]`` over the robot's floor."""
    return np.concatenate([places, heights[..., None]], axis=-1) @ task.robot.base.frame


def start_of(task: SimulatedTask, memory: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the place from which distance counts, of the first robot, shape ``[2]`` (m); zeros on a plane."""
    return np.array(memory[ORIGIN][0]) if task.ground is not None else np.zeros(2)


def name_of(task: SimulatedTask, memory: Mapping[str, np.ndarray]) -> str:
    """Return the kind and level of the first robot's ground in words; nothing on a plane."""
    if task.ground is None:
        return ""
    kind, level = task.ground.describe(int(memory[LANE][0]))
    return f"{kind}, level {level} of {task.ground.settings.levels}"


def mark_height(ground: Ground | None, place: np.ndarray, half: float) -> float:
    """Return the height of a mark across the way: that of the highest ground below it (m over the robot's floor).

    Args:
        ground: The terrain; ``None`` for a plane.
        place: Middle of the mark, shape ``[2]`` (m).
        half: Half of its length (m).
    """
    if ground is None:
        return 0.0
    line = np.stack([np.full(_SAMPLES, place[0]), place[1] + np.linspace(-half, half, _SAMPLES)], axis=-1)
    return float(ground.level(line).max())


def draw_rays(scene: mujoco.MjvScene, points: np.ndarray) -> None:
    """Draw a dot where each ray meets the ground."""
    for point in points[: max(0, scene.maxgeom - scene.ngeom)]:
        dot = scene.geoms[scene.ngeom]
        mujoco.mjv_initGeom(dot, mujoco.mjtGeom.mjGEOM_SPHERE, np.full(3, _DOT), point, np.eye(3).ravel(), _RAY)
        scene.ngeom += 1
