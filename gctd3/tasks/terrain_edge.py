"""The end of an episode at the edge of the terrain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from gctd3.errors import check_between
from gctd3.tasks.ground import ORIGIN
from gctd3.tasks.heading import coordinate
from gctd3.tasks.terms import Array, RobotFacts, Step, Termination


@dataclass(frozen=True)
class TerrainEdge(Termination):
    """End an episode in which the robot is about to leave the terrain by truncation; the value is bootstrapped.

    The borders between lanes are no edges. On a plane it is left out.

    Attributes:
        margin: Distance of the base from the edge (m).
    """

    truncates: ClassVar[bool] = True

    margin: float = 0.4

    def __post_init__(self) -> None:
        check_between(self, 0, 100, "margin")

    def applies(self, facts: RobotFacts) -> bool:
        """Return whether there is terrain."""
        return facts.ground is not None

    def __call__(self, step: Step) -> Array:
        """Return whether the base is within the margin of the edge, or beyond it, shape ``[*]``."""
        ground, origin = step.facts.ground, step.before[ORIGIN]
        if ground is None:
            return step.diverged
        (low, right), (high, left) = (corner.tolist() for corner in ground.bounds)
        forward = origin[..., 0] + step.now.position
        side = origin[..., 1] + coordinate(step.now, step.facts, "side")
        near = (forward < low + self.margin) | (forward > high - self.margin)
        # A base that cannot move sideways cannot leave there.
        return near | (side < right + self.margin) | (side > left - self.margin) if ground.beside else near
