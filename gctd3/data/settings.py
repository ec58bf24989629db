"""Settings of exploration, replay and collectors. Light: the classes that they build are imported in ``build``."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Literal

from gctd3.errors import ConfigError, check_between

if TYPE_CHECKING:
    from gctd3.robots.robot import Robot

MOST_WORKERS = 10_000
LAST_ROUND = 0.3  # share of a round of steps or sines, at its end, in which robots try the fittest few gaits
GAIT_TIMES = (2.0, 4.0)  # s, without and with reflexes


@dataclass(frozen=True)
class ExplorationSettings:
    """Hold the settings of exploration: the warm-up and the noise.

    Attributes:
        warmup: ``rhythmic``: a sine for every joint, left and right half a period apart (:class:`.Rhythm`);
            ``swinging``: the same gaits, which evolve by the training's reward (:class:`.Swinging`); ``stepping``: feet
            that step to and fro, at sizes by the legs' length, or as a velocity is commanded, which evolve too
            (:class:`.Stepping`, :class:`.CommandedStepping`); ``jumping``: jumps of the commanded heights, which evolve
            too (:class:`.Jumping`); ``uniform``: random actions, each held for a while.
        learning_starts: Frames of the warm-up, of all robots together, before the policy acts; of all its rounds, if it
            has several.
        rounds: Rounds of warmup=stepping, equally long, at most: so many that robots can try the last gaits of each for
            a whole trial. The warm-up goes on for another round while the fittest gaits of the last one, or the policy
            that begins as one of them, miss conditions that end the training. One round takes place where nothing ends
            the training, where gaits cannot be evaluated without a policy, and with collectors in other processes.
        from_standing: Whether robots begin a new episode with each gait that warmup=stepping or swinging tries: then
            each gait has to start from standing, which is the hardest part.
        hold: Control steps for which warmup=uniform holds an action.
        frequency: Lowest and highest frequency of warmup=rhythmic and warmup=swinging (Hz).
        mutation_share: Share of new gaits that are mutations of those that got farthest before (warmup=rhythmic) or
            were paid most (warmup=swinging, stepping, jumping); the rest are drawn anew.
        gait_time: Time for which warmup=swinging and warmup=stepping try a gait (s); ``None`` for 2 s, or 4 s with
            reflexes, since a gait that loses its balance may take so long to fall.
        least_speed: Speed below which a gait of warmup=swinging or stepping counts as less fit, however much the reward
            pays for it (m/s); ``None`` for the reward alone.
        reflexes: Whether the feet of warmup=stepping answer to the body's posture (:func:`.reflexes`); ``None``, which
            earlier versions saved with their runs, counts as true.
        noise: Smallest and largest standard deviation of the Gaussian noise on the policy's actions (half a joint's
            range), spread geometrically over the robots (as Ape-X spreads its epsilons, arXiv:1803.00933); ``None`` for
            a policy that is random by itself.
        noise_time: Correlation time of the noise of every second robot (s), an Ornstein-Uhlenbeck process
            (arXiv:1509.02971) of the same standard deviation; 0 for white noise, as on the others.
    """

    warmup: Literal["rhythmic", "swinging", "stepping", "jumping", "uniform"] = "rhythmic"
    learning_starts: int = 10_000
    rounds: int = 1
    from_standing: bool = False
    hold: int = 5
    frequency: Sequence[float] = (1.2, 2.4)
    mutation_share: float = 0.0
    gait_time: float | None = None
    least_speed: float | None = None
    reflexes: bool | None = True
    noise: Sequence[float] | None = (0.05, 0.5)
    noise_time: float = 0.0

    def __post_init__(self) -> None:
        if self.learning_starts < 0:
            raise ConfigError(f"learning_starts must be at least 0, got {self.learning_starts}.")
        if self.rounds < 1:
            raise ConfigError(f"rounds must be at least 1, got {self.rounds}.")
        if self.hold < 1:
            raise ConfigError(f"hold must be at least 1, got {self.hold}.")
        if len(self.frequency) != 2 or not 0 < self.frequency[0] <= self.frequency[1]:
            raise ConfigError(f"frequency must be [lowest, highest] > 0 Hz, got {list(self.frequency)}.")
        if self.gait_time is not None and not self.gait_time > 0:
            raise ConfigError(f"gait_time must be above 0 s, got {self.gait_time}.")
        if self.least_speed is not None and not self.least_speed > 0:
            raise ConfigError(f"least_speed must be above 0 m/s, or null, got {self.least_speed}.")
        if not 0.0 <= self.mutation_share <= 1.0:
            raise ConfigError(f"mutation_share must be between 0 and 1, got {self.mutation_share}.")
        # Actions are clipped to [-1, 1]: noise beyond that is no longer noise on an action.
        if self.noise is not None and (len(self.noise) != 2 or not 0 < self.noise[0] <= self.noise[1] <= 10):
            raise ConfigError(f"noise must be [smallest, largest] > 0 and <= 10, or null, got {list(self.noise)}.")
        if self.noise_time < 0:
            raise ConfigError(f"noise_time must be at least 0 s, got {self.noise_time}.")

    @property
    def in_workers(self) -> ExplorationSettings:
        """Return the settings of explorers in other processes, where nobody ends rounds and episodes for them."""
        frames = self.learning_starts // (self.rounds if self.warmup == "stepping" else 1)
        return replace(self, learning_starts=frames, rounds=1, from_standing=False)

    def rounds_of(self, duration: float) -> int:
        """Return the rounds of a warm-up of so many seconds, each of which ends with a whole trial or more."""
        return max(1, min(self.rounds, int(LAST_ROUND * duration / self.trial))) if self.warmup == "stepping" else 1

    @property
    def answers(self) -> bool:
        """Return whether feet step that answer to the body's posture."""
        return self.warmup == "stepping" and self.reflexes is not False

    @property
    def trial(self) -> float:
        """Return the time for which an evolving gait is tried (s)."""
        return GAIT_TIMES[self.answers] if self.gait_time is None else self.gait_time

    def check_robot(self, robot: Robot, control_dt: float) -> None:
        """Raise a :class:`.ConfigError` if a robot cannot be moved like this.

        Args:
            robot: The robot.
            control_dt: Control period (s).
        """
        if self.warmup == "stepping" and not robot.hips:
            raise ConfigError("exploration.warmup must not be stepping: the robot has no leg.")
        if self.warmup not in ("rhythmic", "swinging"):
            return
        if self.frequency[1] > 0.5 / control_dt:
            raise ConfigError(
                f"exploration.frequency must be at most half a cycle a control step, {0.5 / control_dt:g} Hz, "
                f"got {list(self.frequency)}."
            )
        # Only joints have mirror images.
        if len(robot.actuated) != robot.model.nu:
            raise ConfigError(
                f"exploration.warmup must be uniform, got {self.warmup}: {robot.model.nu - len(robot.actuated)} of the "
                f"{robot.model.nu} actions move no joint, and only joints have a mirror image."
            )


@dataclass(frozen=True)
class ReplaySettings:
    """Hold the settings of the replay: how transitions are stored and drawn.

    Attributes:
        buffer_size: Capacity (transitions); the oldest leave first.
        batch_size: Transitions drawn for an update.
        n_step: Rewards summed before the bootstrap (Sutton 1988).
        mirror: Reflect half of every batch in the robot's sagittal plane: ``auto`` where the robot's two sides move
            alike (:func:`.check_mirror`), and the run says what differs where they do not; true refuses such a robot.
        storage: ``frames``: every frame once, stacked when drawn (:class:`.FrameBuffer`); ``stacked``: the stacks, in
            TorchRL's buffer, at six times the memory.
    """

    buffer_size: int = 1_000_000
    batch_size: int = 256
    n_step: int = 3
    mirror: Literal["auto"] | bool = "auto"
    storage: Literal["frames", "stacked"] = "frames"

    def __post_init__(self) -> None:
        check_between(self, 1, 10**12, "buffer_size")
        check_between(self, 1, 10**6, "batch_size")
        check_between(self, 1, 1000, "n_step")
        if self.batch_size > self.buffer_size:
            raise ConfigError(f"batch_size must be at most buffer_size, got {self.batch_size} and {self.buffer_size}.")


@dataclass(frozen=True)
class InlineSettings:
    """Hold the settings of collecting and learning in turns in one process: nothing to set.

    Attributes:
        chunk: Control steps collected at once, as a multiple of rollout_steps.
    """

    chunk: ClassVar[int] = 1

    def check_here(self, num_envs: int) -> None:
        """Accept any machine and any number of robots."""


@dataclass(frozen=True)
class ProcessSettings:
    """Hold the settings of processes on this machine that step the robots while the learner learns.

    Attributes:
        workers: Processes, among which env.num_envs robots are divided.
        cpus: Threads of each process, for its simulation and its policy; env.threads does not count.
        chunk: Control steps between two messages, as a multiple of rollout_steps; gradient_steps
            are multiplied as well.
        timeout: Time after which a worker that delivers nothing counts as hung, and is replaced (s).
        start_within: Time that a worker may take to start (s).
        max_restarts: Failures of a worker in a row, without a batch in between, that are tolerated; one more ends the
            run with a checkpoint.
    """

    workers: int = 2
    cpus: int = 1
    chunk: int = 4
    timeout: float = 60.0
    start_within: float = 300.0
    max_restarts: int = 3

    def __post_init__(self) -> None:
        check_between(self, 1, MOST_WORKERS, "workers", "chunk")
        check_between(self, 1, 1024, "cpus")
        check_between(self, 0, 10**6, "max_restarts")
        for name in ("timeout", "start_within"):
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
        """Return the robots of each worker, as slices."""
        bounds = [num_envs * i // self.workers for i in range(self.workers + 1)]
        return [slice(start, stop) for start, stop in itertools.pairwise(bounds)]


@dataclass(frozen=True)
class RaySettings(ProcessSettings):
    """Hold the settings of workers on a Ray cluster that step the robots while the learner learns.

    Attributes:
        workers: Workers, among which env.num_envs robots are divided.
        cpus: CPUs of the cluster that each worker takes, for its simulation and its policy; env.threads does not count.
        start_within: Time that a worker may take to start, waiting for free CPUs included (s).
        address: ``host:port`` of the cluster's head node; ``auto``: the cluster that runs here; ``None``: one starts
            here and ends with the run.
    """

    chunk: int = 8
    address: str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.address not in (None, "auto") and not re.fullmatch(r"[^\s:/]+:\d{1,5}", self.address or ""):
            raise ConfigError(f"address must be host:port, auto or null, got {self.address!r}.")

    def check_here(self, num_envs: int) -> None:
        """Join the cluster, or start it, and check that it can run the workers.

        Raises:
            ConfigError: If Ray is not installed, nothing answers at the address, or the CPUs do not suffice.
            WorkerError: If a node has another version of a required package than this machine.
        """
        super().check_here(num_envs)
        from gctd3.data.ray_cluster import check_cluster

        check_cluster(self.address, self.workers, self.cpus)
