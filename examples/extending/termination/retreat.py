"""A termination of one's own: end the episode of a robot that walks backwards.

Train with it:

    PYTHONPATH=examples/extending/termination python -m gctd3.train \
        --config-dir=examples/extending/termination task=no_retreat
"""

from __future__ import annotations

from dataclasses import dataclass

from gctd3.errors import ConfigError
from gctd3.tasks.terms import Array, Step, Termination


@dataclass(frozen=True)
class Retreat(Termination):
    """End when the robot is behind its start.

    Attributes:
        distance: How far behind (m).
    """

    distance: float = 0.3

    def __post_init__(self) -> None:
        if not self.distance > 0:
            raise ConfigError(f"distance must be above 0 m, got {self.distance}.")

    def __call__(self, step: Step) -> Array:
        """Return whether it is that far behind, shape ``[*]``."""
        return step.now.position < -self.distance
