"""Bounds of what a walking robot can do, so that one that explodes and lands behind the finish has not walked there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gctd3.engines.walk import Walk

WINDOW = 0.5  # s over which speeds are averaged


@dataclass(frozen=True)
class Bounds:
    """Hold bounds of a walk, each far beyond what MuJoCo's walks from the same starts do.

    Attributes:
        height: Highest body above standing (m): half a leg's length, or twice MuJoCo's.
        speed: Fastest half second (m/s): three times MuJoCo's, or 1 m/s.
        rate: Fastest joint (rad/s): three times MuJoCo's, or 30 rad/s.
        sink: Deepest foot below the ground (m): a twentieth of a leg's length, or twice MuJoCo's.
        air: Longest time with no foot on the ground (s): half a second, or twice MuJoCo's.
        dt: Control period (s).
    """

    height: float
    speed: float
    rate: float
    sink: float
    air: float
    dt: float

    @classmethod
    def of(cls, walks: Sequence[Walk], leg: float, dt: float) -> Bounds:
        """Compute the bounds from MuJoCo's walks and the length of the robot's legs (m)."""
        return cls(
            height=max(0.5 * leg, *(2 * float(walk.height.max()) for walk in walks)),
            speed=max(1.0, *(3 * _fastest(walk, dt) for walk in walks)),
            rate=max(30.0, *(3 * float(np.abs(walk.rates).max()) for walk in walks)),
            sink=max(0.05 * leg, *(-2 * float(np.nanmin(walk.lowest)) for walk in walks)),
            air=max(0.5, *(2 * _airborne(walk) * dt for walk in walks)),
            dt=dt,
        )

    def broken(self, walk: Walk) -> list[str]:
        """Return a phrase for each bound that a walk breaks."""
        dt = self.dt
        if not (np.isfinite(walk.lowest).all() and np.isfinite(walk.position).all()):
            return ["the simulation exploded"]
        checks = (
            ("the body rose to", float(walk.height.max()), self.height, "m"),
            ("it moved at", _fastest(walk, dt), self.speed, "m/s"),
            ("a joint turned at", float(np.abs(walk.rates).max()), self.rate, "rad/s"),
            ("a foot sank by", -float(walk.lowest.min()), self.sink, "m"),
            ("no foot was down for", _airborne(walk) * dt, self.air, "s"),
        )
        return [
            f"{what} {value:.3g} {unit}, more than {most:.3g}" for what, value, most, unit in checks if value > most
        ]


def _fastest(walk: Walk, dt: float) -> float:
    """Return the largest speed over a window, either way (m/s)."""
    steps = min(round(WINDOW / dt), len(walk.position) - 1)
    if steps < 1:
        return 0.0
    return float(np.abs(walk.position[steps:] - walk.position[:-steps]).max()) / (steps * dt)


def _airborne(walk: Walk) -> int:
    """Return the largest number of control steps in a row with no foot down."""
    longest = run = 0
    for down in np.asarray(walk.feet_down.any(axis=1)).tolist():
        run = 0 if down else run + 1
        longest = max(longest, run)
    return longest
