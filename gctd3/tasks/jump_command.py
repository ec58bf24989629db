"""The commanded height of a jump: how far all soles are to be above the ground at its apex."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gctd3.errors import ConfigError
from gctd3.tasks.memory import COMMAND
from gctd3.tasks.terms import Command, RobotFacts

NAME = "jump"  # of the command in the task
HEIGHT = f"{COMMAND}{NAME}"  # name of its array, shape [*, 1] (m)
LEAST = 0.03  # of a level (m): soles are up to 0.0235 m above the ground where robots are dropped


@dataclass(frozen=True)
class JumpCommand(Command):
    """Draw the height of a jump from a few levels, for the whole episode.

    Attributes:
        every: Time after which the height is drawn anew (s): longer than any episode.
        levels: Heights of the lowest sole above the ground at the apex, rising (m), each as likely as the others.
    """

    every: float = 1e6
    levels: Sequence[float] = (0.10, 0.13, 0.16)

    def __post_init__(self) -> None:
        super().__post_init__()
        levels = list(self.levels)
        if not levels or levels != sorted(set(levels)) or not levels[0] >= LEAST or not math.isfinite(levels[-1]):
            raise ConfigError(f"levels must hold heights of at least {LEAST} m that rise, got {levels}.")

    @property
    def size(self) -> int:
        """Return the length of the command."""
        return 1

    def fitted(self, facts: RobotFacts) -> JumpCommand:
        """Return the command for a robot.

        Raises:
            ConfigError: If the legs are too short for the highest level, or the height of a sole cannot be computed.
        """
        if facts.soles is None:
            raise ConfigError(
                f"task.commands.{NAME} needs the heights of the soles, for which the angle of each joint of a leg "
                "has to be measured: a robot whose legs have other joints cannot be asked to jump."
            )
        if self.levels[-1] > facts.leg_length:
            raise ConfigError(
                f"task.commands.{NAME}.levels must be at most {facts.leg_length:.3f} m, the length of the legs, "
                f"further than which no leg can be drawn up, got {list(self.levels)}."
            )
        return self

    def __call__(self, rng: np.random.Generator | np.random.RandomState, count: int) -> np.ndarray:
        """Draw a height for each of ``count`` robots, shape ``[count, 1]`` (m)."""
        levels = np.asarray(self.levels, dtype=np.float64)
        return levels[(len(levels) * rng.uniform(size=(count, 1))).astype(np.int64)]
