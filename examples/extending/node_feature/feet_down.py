"""A node feature of one's own: tell the root how many feet are on the ground.

Train with it:

    PYTHONPATH=examples/extending/node_feature python -m gctd3.train \
        --config-dir=examples/extending/node_feature task=walk_counting_feet
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gctd3.robots.robot import Robot
from gctd3.tasks.features import NodeFeature, Reading, Sensed


@dataclass(frozen=True)
class FeetDown(NodeFeature):
    """Sense the number of feet on the ground at the root; the mirrored robot has as many."""

    kind: ClassVar[str] = "root"

    def readings(self, robot: Robot, nodes: tuple[str, ...]) -> list[list[Reading | None]]:
        """Return what it is, for the mirror, the exported contract and sensor noise."""
        return [[Reading("feet_down", "number of feet that touch the ground", "contact")]]

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return the number, shape ``[*, 1, 1]``."""
        return sensed.now.feet_down.sum(axis=-1)[..., None, None]
