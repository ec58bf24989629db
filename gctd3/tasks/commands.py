"""Commands to a robot, as inputs of its policy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gctd3.errors import ConfigError
from gctd3.tasks.terms import Command


@dataclass(frozen=True)
class UniformCommand(Command):
    """Draw each number of the command uniformly from its range.

    Attributes:
        low: Lower bound of each number.
        high: Upper bound of each number.
    """

    low: Sequence[float] = (0.0,)
    high: Sequence[float] = (1.0,)

    def __post_init__(self) -> None:
        super().__post_init__()
        rising = len(self.low) == len(self.high) and all(a <= b for a, b in zip(self.low, self.high, strict=True))
        if not self.low or not rising:
            raise ConfigError(
                f"low and high must hold as many numbers, low at most high, got {list(self.low)} and {list(self.high)}."
            )

    @property
    def size(self) -> int:
        """Return the length ``K`` of the command."""
        return len(self.low)

    def __call__(self, rng: np.random.Generator | np.random.RandomState, count: int) -> np.ndarray:
        """Draw a command for each of ``count`` robots, shape ``[count, K]``."""
        return np.asarray(rng.uniform(self.low, self.high, (count, self.size)))
