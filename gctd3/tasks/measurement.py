"""Measurements of a control step: arrays, with an entry for each robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np


@dataclass(frozen=True)
class Measurement:
    """Hold the measurements of one control step.

    Attributes:
        position: Distance walked, shape ``[*]`` (m).
        height: Body height from standing, shape ``[*]`` (m).
        velocity: Forward velocity, shape ``[*]`` (m/s).
        angles: Joint angles in the order of ``robot.joints``, shape ``[*, J]`` (rad).
        velocities: Joint velocities, shape ``[*, J]`` (rad/s).
        feet_down: Whether each foot touches the ground, shape ``[*, feet]``.
        other_down: Whether anything but feet and shanks touches the ground, shape ``[*]``.
        shank_down: Whether a shank touches the ground, shape ``[*]``; never where the shank is the foot.
        base: The base's other coordinates and their rates in the order of ``robot.base.extra``, from standing, shape
            ``[*, E, 2]`` (rad and rad/s; ``side`` m and m/s); a boom has none (``E = 0``).
        tilt: Angle between the body's vertical and the world's, shape ``[*]`` (rad).
        feet_velocity: Velocity of each foot in the base's frame of :attr:`.Base.frame`, shape ``[*, feet, 3]`` (m/s);
            shape ``[*, 0, 3]`` where it is not measured.
    """

    position: np.ndarray
    height: np.ndarray
    velocity: np.ndarray
    angles: np.ndarray
    velocities: np.ndarray
    feet_down: np.ndarray
    other_down: np.ndarray
    shank_down: np.ndarray
    base: np.ndarray
    tilt: np.ndarray
    feet_velocity: np.ndarray

    def to_dict(self) -> dict[str, np.ndarray]:
        """Return copies of the arrays, by name."""
        return {field.name: np.array(getattr(self, field.name)) for field in fields(self)}

    @classmethod
    def from_dict(cls, values: Mapping[str, np.ndarray]) -> Measurement:
        """Build a measurement from the arrays of :meth:`to_dict`."""
        return cls(**{field.name: np.array(values[field.name]) for field in fields(cls)})

    def put(self, robots: np.ndarray, part: Measurement) -> Measurement:
        """Replace the rows ``robots`` of arrays ``[N, ...]`` by those of ``part``, in new arrays."""
        return Measurement(**put_rows(vars(self), robots, vars(part)))

    def take(self, robots: np.ndarray) -> Measurement:
        """Select the rows ``robots`` of arrays ``[N, ...]``."""
        return Measurement(**{field.name: getattr(self, field.name)[robots] for field in fields(self)})


def put_rows(
    whole: Mapping[str, np.ndarray], robots: np.ndarray, part: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Replace the rows ``robots`` of each array ``[N, ...]`` by those of ``part``, in new arrays."""
    merged = {}
    for name, values in whole.items():
        merged[name] = values.copy()
        merged[name][robots] = part[name]
    return merged
