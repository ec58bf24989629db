"""Settings of exploration, replay and collectors. Light: what they set is imported when it is built."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

from gctd3.errors import ConfigError, check_between

MOST_WORKERS = 10_000


@dataclass(frozen=True)
class ExplorationSettings:
    """Warm-up and noise.

    Attributes:
        warmup: ``rhythmic``: see :class:`Rhythm`; ``uniform``: uniform actions, each held for a while.
        warmup_frames: Frames (all robots together) before the policy acts.
        hold: Control steps for which ``uniform`` holds an action.
        frequency: Lowest and highest frequency of ``rhythmic`` (Hz).
        heirs: Share of ``rhythmic``'s gaits that descend from those that got farthest before; the rest are drawn anew.
        noise: Smallest and largest standard deviation of the Gaussian noise on the policy's actions, spread
            geometrically over the robots (as Ape-X spreads its epsilons, arXiv:1803.00933); ``None`` for a policy that
            is random by itself.
        noise_time: Correlation time (s) of the noise of every second robot, an Ornstein-Uhlenbeck process (Lillicrap et
            al. 2016, arXiv:1509.02971) of the same standard deviation; 0 for white noise as on the others.
    """

    warmup: Literal["rhythmic", "uniform"] = "rhythmic"
    warmup_frames: int = 10_000
    hold: int = 5
    frequency: Sequence[float] = (1.2, 2.4)
    heirs: float = 0.0
    noise: Sequence[float] | None = (0.05, 0.5)
    noise_time: float = 0.0

    def __post_init__(self) -> None:
        if self.warmup_frames < 0:
            raise ConfigError(f"warmup_frames must be at least 0, got {self.warmup_frames}.")
        if self.hold < 1:
            raise ConfigError(f"hold must be at least 1, got {self.hold}.")
        if len(self.frequency) != 2 or not 0 < self.frequency[0] <= self.frequency[1]:
            raise ConfigError(f"frequency must be [lowest, highest] > 0 Hz, got {list(self.frequency)}.")
        if not 0.0 <= self.heirs <= 1.0:
            raise ConfigError(f"heirs must be between 0 and 1, got {self.heirs}.")
        # Actions are clipped to [-1, 1]: noise beyond that is no longer noise on an action.
        if self.noise is not None and (len(self.noise) != 2 or not 0 < self.noise[0] <= self.noise[1] <= 10):
            raise ConfigError(f"noise must be [smallest, largest] > 0 and <= 10, or null, got {list(self.noise)}.")
        if self.noise_time < 0:
            raise ConfigError(f"noise_time must be at least 0 s, got {self.noise_time}.")


@dataclass(frozen=True)
class ReplaySettings:
    """What is remembered and how it is drawn.

    Attributes:
        capacity: Transitions kept; the oldest leave first.
        batch_size: Transitions drawn for an update.
        n_step: Rewards summed before the bootstrap (Sutton 1988).
        mirror: Whether half of every batch is reflected in the robot's sagittal plane.
        storage: ``frames`` stores every frame once and stacks at sampling, as :class:`.FrameBuffer` does;
            ``stacked`` stores the stacks as they came, in TorchRL's buffer, at six times the memory.
    """

    capacity: int = 1_000_000
    batch_size: int = 256
    n_step: int = 3
    mirror: bool = True
    storage: Literal["frames", "stacked"] = "frames"

    def __post_init__(self) -> None:
        check_between(self, 1, 10**12, "capacity")
        check_between(self, 1, 10**6, "batch_size")
        check_between(self, 1, 1000, "n_step")
        if self.batch_size > self.capacity:
            raise ConfigError(f"batch_size must be at most capacity, got {self.batch_size} and {self.capacity}.")


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


@dataclass(frozen=True)
class RaySettings(ProcessSettings):
    """Workers on a Ray cluster.

    Attributes:
        address: ``host:port`` of the cluster's head node, or ``auto`` for the cluster that runs on this machine;
            ``None`` starts one on this machine that ends with the training.
    """

    address: str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.address not in (None, "auto") and not re.fullmatch(r"[^\s:/]+:\d{1,5}", self.address or ""):
            raise ConfigError(f"address must be host:port, auto or null, got {self.address!r}.")

    def check_here(self, num_envs: int) -> None:
        """Join the cluster, or start it, and check that it can do the work.

        Raises:
            ConfigError: If Ray is not installed, nothing answers at the address, or the CPUs do not suffice.
            WorkerError: If the nodes have other versions of what matters than this machine.
        """
        super().check_here(num_envs)
        from gctd3.data.ray_cluster import check_cluster

        check_cluster(self.address, self.workers, self.cpus)
