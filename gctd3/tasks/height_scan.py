"""Sight: heights of the ground around the body, as a map made from cameras or a lidar gives them.

For policies as a feature, for critics alone as a privileged one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from gctd3.errors import ConfigError, check_between
from gctd3.robots.robot import Robot
from gctd3.tasks.features import NodeFeature, Reading, Sensed
from gctd3.tasks.ground import turned
from gctd3.tasks.heading import coordinate
from gctd3.tasks.terms import RobotFacts

MOST_RAYS = 1000


@dataclass(frozen=True)
class HeightScan(NodeFeature):
    """Measure the ground's height at an array of rays around the body (m), turned with its heading, at the root.

    Heights are relative to where the soles would be if the robot stood at the body's height: 0 on level ground. Rays
    are vertical; one that misses the terrain reads the floor around it. Without terrain all read minus the body's
    height from standing.

    Attributes:
        length: Length of the array forward (m).
        width: Its width (m).
        ahead: Distance of its middle in front of the body (m).
        along: Number of rays forward.
        across: Number of rays to the left.
        farthest: Largest height that is measured, up and down (m).
        noise: Standard deviation of each ray's error in each frame (m); none in evaluations and for critics.
    """

    kind: ClassVar[str] = "root"

    length: float = 1.0
    width: float = 0.6
    ahead: float = 0.2
    along: int = 6
    across: int = 3
    farthest: float = 0.5
    noise: float = 0.01

    def __post_init__(self) -> None:
        check_between(self, 0, 100, "length", "width", "noise")
        check_between(self, 1, MOST_RAYS, "along", "across")
        check_between(self, -100, 100, "ahead")
        if self.along * self.across > MOST_RAYS:
            raise ConfigError(f"along * across must be at most {MOST_RAYS:,} rays, got {self.along * self.across:,}.")
        if not self.farthest > 0:
            raise ConfigError(f"farthest must be above 0 m, got {self.farthest}.")

    @property
    def rays(self) -> np.ndarray:
        """Return the place of each ray from the body, forward and to the left, shape ``[along, across, 2]`` (m)."""
        forward = self.ahead + (np.linspace(-0.5, 0.5, self.along) if self.along > 1 else np.zeros(1)) * self.length
        left = (np.linspace(-0.5, 0.5, self.across) if self.across > 1 else np.zeros(1)) * self.width
        return np.stack(np.meshgrid(forward, left, indexing="ij"), axis=-1)

    def check(self, facts: RobotFacts) -> None:
        """Raise a :class:`.ConfigError` if the array is larger than the terrain."""
        if facts.ground is None:
            return
        settings = facts.ground.settings
        for name, most in (("width", settings.width), ("length", settings.behind + settings.length)):
            if getattr(self, name) > most:
                raise ConfigError(
                    f"{name} must be at most {most:g} m, that of the terrain's lanes, got {getattr(self, name):g}."
                )

    def deviation(self) -> float:
        """Return the standard deviation of each number's own error."""
        return self.noise

    def evaluated(self) -> HeightScan:
        """Return the feature without its noise."""
        return replace(self, noise=0.0)

    def readings(self, robot: Robot, nodes: tuple[str, ...]) -> list[list[Reading | None]]:
        """Return the readings of the rays, from back to front, and from right to left in a row."""
        row: list[Reading | None] = []
        for i, places in enumerate(self.rays):
            for k, (forward, left) in enumerate(places):
                where = f"{forward:+.2f} m forward and {left:+.2f} m to the left of the body"
                meaning = f"height of the ground {where}, from where the soles of the standing robot would be"
                row.append(Reading(f"ground_{i}_{k}_m", meaning, "ground", source="height map"))
        return [row]

    def places(self, sensed: Sensed) -> np.ndarray:
        """Return where the rays meet the ground, by the base's place and yaw alone, shape ``[*, rays, 2]`` (m).

        Raises:
            ValueError: If the task has no terrain.
        """
        now, facts = sensed.now, sensed.facts
        if facts.ground is None:
            raise ValueError("Without terrain rays have no place.")
        here = facts.ground.whereabouts(now, coordinate(now, facts, "side"), sensed.memory)
        rays = turned(self.rays.reshape(-1, 2), np.asarray(coordinate(now, facts, "yaw"))[..., None])
        return np.asarray(here[..., None, :] + rays)

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return the heights, shape ``[*, 1, rays]``."""
        now, ground = sensed.now, sensed.facts.ground
        if ground is None:
            heights = np.broadcast_to(-now.height[..., None], (*now.height.shape, self.along * self.across))
        else:
            here = ground.whereabouts(now, coordinate(now, sensed.facts, "side"), sensed.memory)
            soles = now.height + ground.below(here, np.asarray(coordinate(now, sensed.facts, "yaw")))
            heights = ground.height(self.places(sensed)) - soles[..., None]
        return np.clip(heights, -self.farthest, self.farthest)[..., None, :]

    def mirror_places(self, robot: Robot, nodes: tuple[str, ...]) -> np.ndarray:
        """Return the sources that exchange the rays on the left and on the right."""
        numbers = np.arange(self.along * self.across).reshape(self.along, self.across)[:, ::-1].reshape(-1)
        return np.stack([np.zeros_like(numbers), numbers], axis=-1)[None]
