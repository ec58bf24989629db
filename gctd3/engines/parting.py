"""Where two engines part: at the servos, at the first contact with the ground, or later, by drift.

The order is that of causes: a servo that differs in free flight explains everything after it, and a first contact that
differs explains the walk.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from gctd3.engines.engine import Engine
from gctd3.engines.walk import Sensing, Walk
from gctd3.tasks.simulated_task import SimulatedTask

Boundary = Literal["servo", "first contact", "drift"]
FLIGHT, ABOVE = 0.3, 10.0  # s of a free flight, and m above the ground where it begins
SERVO = 0.05  # rad by which joints may differ in free flight
LANDING = 0.2  # s from the first contact on that count as that
ANGLE, HEIGHT = 0.15, 0.03  # rad and m by which walks may differ


@dataclass(frozen=True)
class Parting:
    """Describe where the walk of one start parts from MuJoCo's.

    Attributes:
        boundary: Boundary.
        time: Time from the start (s).
    """

    boundary: Boundary
    time: float


def flight_difference(
    task: SimulatedTask, one: Engine, other: Engine, start: tuple[np.ndarray, np.ndarray], desired: np.ndarray
) -> float:
    """Return the largest difference of a joint's angle in free flight under the same desired angles (rad).

    Args:
        task: The task.
        one: An engine.
        other: Another one.
        start: Initial ``qpos`` and ``qvel``; both begin high above the ground.
        desired: Desired angles of a walk, shape ``[T, A]`` (rad), of which the first are taken.
    """
    sensing, largest = Sensing(task), 0.0
    for engine in (one, other):
        engine.reset(*start, above=ABOVE)
    for angles in desired[: round(FLIGHT / task.control_dt)]:
        places = []
        for engine in (one, other):
            engine.advance(angles)
            now, _, finite = sensing(engine)
            places.append(now.angles if finite else np.full(now.angles.shape, np.inf))
        with np.errstate(invalid="ignore"):
            difference = float(np.abs(places[0] - places[1]).max())
        largest = max(largest, difference if np.isfinite(difference) else np.inf)
    return largest


def find_parting(walk: Walk, reference: Walk, flight: float, dt: float) -> Parting:
    """Find the boundary at which a walk parts from MuJoCo's from the same start.

    Args:
        walk: The walk.
        reference: MuJoCo's walk.
        flight: Their :func:`flight_difference` (rad).
        dt: Control period (s).
    """
    steps = min(len(walk.position), len(reference.position))
    apart = np.abs(walk.angles[:steps] - reference.angles[:steps]).max(axis=1) > ANGLE
    apart |= np.abs(walk.height[:steps] - reference.height[:steps]) > HEIGHT
    apart |= ~np.isfinite(walk.lowest[:steps])
    # One that ends earlier has parted by then.
    first = int(np.argmax(apart)) if apart.any() else steps - 1
    time = (first + 1) * dt
    down = walk.feet_down[:steps].any(axis=1) | reference.feet_down[:steps].any(axis=1)
    landed = int(np.argmax(down)) if down.any() else steps
    if flight > SERVO or first < landed:
        return Parting("servo", time)
    return Parting("first contact" if time <= landed * dt + LANDING else "drift", time)
