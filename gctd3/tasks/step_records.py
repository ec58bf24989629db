"""What the walking task measures, remembers of an episode and makes of a step: arrays, an entry for each robot."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import TypeVar

import numpy as np


@dataclass(frozen=True)
class Measurement:
    """What one control step measures.

    Attributes:
        position: Distance walked, shape ``[*]`` (m).
        height: Body height from standing, shape ``[*]`` (m).
        velocity: Forward velocity, shape ``[*]`` (m/s).
        angles: Joint angles in the order of ``robot.joints``, shape ``[*, J]`` (rad).
        velocities: Joint velocities, shape ``[*, J]`` (rad/s).
        feet_down: Whether each foot touches the ground, shape ``[*, feet]``.
        other_down: Whether anything else touches the ground, shape ``[*]``.
        base: The base's other coordinates and their rates in the order of ``robot.base.extra``, from standing, shape
            ``[*, E, 2]`` (rad and rad/s; ``side`` m and m/s); a boom has none (``E = 0``).
        tilt: Angle between the body's vertical and the world's, shape ``[*]`` (rad).
    """

    position: np.ndarray
    height: np.ndarray
    velocity: np.ndarray
    angles: np.ndarray
    velocities: np.ndarray
    feet_down: np.ndarray
    other_down: np.ndarray
    base: np.ndarray
    tilt: np.ndarray


@dataclass(frozen=True)
class Progress:
    """What the task remembers of an episode; every array is overwritten by the next, none changes in place.

    Attributes:
        step: Control steps taken, shape ``[*]``.
        positions: The last ``progress_steps + 1`` positions, oldest first, shape ``[*, progress_steps + 1]`` (m).
        heights: The stacked frames' body heights, oldest first, shape ``[*, frames]`` (m).
        feet_down: The stacked frames' foot contacts, shape ``[*, frames, feet]``.
        contact_steps: Steps for which each foot has been down, shape ``[*, feet]``.
        air_steps: Steps for which each foot has been up, shape ``[*, feet]``.
        hip_steps: Steps for which each hip has kept its sign, shape ``[*, feet]``.
        hip_positive: That sign, shape ``[*, feet]``.
    """

    step: np.ndarray
    positions: np.ndarray
    heights: np.ndarray
    feet_down: np.ndarray
    contact_steps: np.ndarray
    air_steps: np.ndarray
    hip_steps: np.ndarray
    hip_positive: np.ndarray


Arrays = TypeVar("Arrays", Measurement, Progress)


def put(whole: Arrays, robots: np.ndarray, part: Arrays) -> Arrays:
    """``whole``, arrays of shape ``[N, ...]``, with the rows ``robots`` replaced by those of ``part``."""
    merged = {}
    for field in fields(whole):
        merged[field.name] = getattr(whole, field.name).copy()
        merged[field.name][robots] = getattr(part, field.name)
    return type(whole)(**merged)


def take(whole: Arrays, robots: np.ndarray) -> Arrays:
    """The rows ``robots`` of arrays of shape ``[N, ...]``."""
    return type(whole)(**{field.name: getattr(whole, field.name)[robots] for field in fields(whole)})


def to_dict(arrays: Measurement | Progress) -> dict[str, np.ndarray]:
    """Copies of the arrays, by name."""
    return {field.name: getattr(arrays, field.name).copy() for field in fields(arrays)}


def from_dict(kind: type[Arrays], values: Mapping[str, np.ndarray]) -> Arrays:
    """What :func:`to_dict` was given; ``kind`` is its class."""
    return kind(**{field.name: np.array(values[field.name]) for field in fields(kind)})


@dataclass(frozen=True)
class Outcome:
    """What a step was worth and whether it ended the episode; every array has shape ``[*]``.

    Attributes:
        terms: The reward, term by term; its sum is :attr:`reward`.
        terminated: The robot fell, stood too long on a foot or kept a hip too long on one side.
        truncated: It reached the finish or the time limit (and did not terminate).
        success: It reached the finish (and did not terminate).
        diverged: The simulation failed.
    """

    terms: dict[str, np.ndarray]
    terminated: np.ndarray
    truncated: np.ndarray
    success: np.ndarray
    diverged: np.ndarray

    @property
    def reward(self) -> np.ndarray:
        """The sum of the terms."""
        return functools.reduce(np.add, self.terms.values())
