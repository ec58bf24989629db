"""Settings of the collectors: who steps the robots, and how patient the learner is with them."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import ClassVar

from gctd3.errors import ConfigError, check_between

MOST_WORKERS = 10_000


@dataclass(frozen=True)
class InlineSettings:
    """Collecting and learning take turns, in one process.

    Attributes:
        chunk: Of every batch of steps, how many are collected at once.
    """

    chunk: ClassVar[int] = 1

    def check_here(self, num_envs: int) -> None:
        """Nothing of this machine matters."""


@dataclass(frozen=True)
class ProcessSettings:
    """Collecting beside learning: processes that step their share of the robots while the learner learns.

    Attributes:
        workers: Processes, among which the robots are divided.
        cpus: Threads of each, for its simulation and its policy.
        chunk: As many times ``steps`` are collected between two messages, and as many times ``updates`` follow.
        patience: Time (s) after which a worker that delivers nothing counts as hung.
        start_within: Time (s) that a worker may take to start.
        failures: Failures of a worker in a row, without a batch in between, that are borne; at one more the run ends.
    """

    workers: int = 2
    cpus: int = 1
    chunk: int = 4
    patience: float = 60.0
    start_within: float = 300.0
    failures: int = 3

    def __post_init__(self) -> None:
        check_between(self, 1, MOST_WORKERS, "workers", "chunk")
        check_between(self, 1, 1024, "cpus")
        check_between(self, 0, 10**6, "failures")
        for name in ("patience", "start_within"):
            value = getattr(self, name)
            if not 0 < value < math.inf:
                raise ConfigError(f"{name} must be above 0 s, got {value}.")

    def check_here(self, num_envs: int) -> None:
        """Raise a :class:`.ConfigError` if there are more workers than robots."""
        if self.workers > num_envs:
            raise ConfigError(
                f"collector.workers must be at most env.num_envs = {num_envs}, got {self.workers}: "
                "every worker steps some of the robots."
            )

    def shares(self, num_envs: int) -> list[slice]:
        """The robots of each worker."""
        bounds = [num_envs * i // self.workers for i in range(self.workers + 1)]
        return [slice(start, stop) for start, stop in itertools.pairwise(bounds)]
