"""Settings of a training, which determine it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

from gctd3.algorithms.settings import AlgorithmSettings, ImitationSettings
from gctd3.config.requirements import check_dm_control
from gctd3.data.settings import ExplorationSettings, InlineSettings, ProcessSettings, ReplaySettings
from gctd3.envs.settings import MOST_ROBOTS, MOST_THREADS, EnvSettings
from gctd3.envs.simulation import substeps_of
from gctd3.errors import ConfigError, check_between, check_seed
from gctd3.nn.settings import NetworkSettings
from gctd3.robots.settings import GivenRobot, RobotSettings
from gctd3.setup.setup import Setup
from gctd3.tasks.reward import Reward
from gctd3.tasks.task import TaskSettings, check_backend
from gctd3.training.device import check_device, check_index
from gctd3.training.give_up import GiveUp
from gctd3.training.stop_when import RECORDED, StopWhen

if TYPE_CHECKING:
    from gctd3.robots.robot import Robot


@dataclass(frozen=True)
class EvaluationSettings:
    """Hold the settings of the evaluations during training.

    Attributes:
        every: Frames between evaluations; there is one at the end in any case, so it may exceed the training.
        episodes: Episodes of each evaluation.
        seed: Seed of the episodes' starts, the same every time; not the training's.
        reward: Reward under which policies are evaluated.
    """

    reward: Reward
    every: int = 20_000
    episodes: int = 10
    seed: int = 1_000

    def __post_init__(self) -> None:
        check_between(self, 1, math.inf, "every")
        check_between(self, 1, MOST_ROBOTS, "episodes")
        check_seed("seed", self.seed)


@dataclass(frozen=True)
class TrainSettings:
    """Hold all settings that determine a training.

    Attributes:
        robot: Robot and graph.
        task: Task of the robot.
        env: Simulation of the robots: where and how many are stepped.
        reward: Reward for which the policy trains.
        algo: Algorithm.
        network: Networks.
        exploration: Warm-up and noise.
        replay: Memory of transitions.
        imitation: How the policy begins as the gait that the warm-up found.
        evaluation: Evaluations.
        stop_when: Conditions on evaluations.
        give_up: Signs by which a training that cannot succeed is ended.
        collector: Processes that step the robots.
        seed: Seed of networks, exploration, replay and starts.
        total_frames: Frames (control steps of single robots) to collect at most.
        total_episodes: Episodes to train at most, counted as they end; ``None`` for any number.
        time_limit: Time after which this session of the run ends with a checkpoint, to be continued (min); ``None``
            for no limit.
        rollout_steps: Control steps of every robot between updates.
        gradient_steps: Updates of the networks after every rollout_steps.
        device: Device of networks and replay: cpu, cuda, cuda:1, ...; without a GPU it falls back to the CPU and says
            so. Robots are on the CPU.
        threads: CPU threads of PyTorch; ``None`` for PyTorch's default.
        logger: Logger of curves, besides progress.csv: csv, tensorboard, wandb, mlflow (where MLFLOW_TRACKING_URI says)
            or none.
        video: Film every policy that is evaluated: ``videos/*.mp4`` in the run, and in TensorBoard, wandb or mlflow.
        keep_checkpoints: Newest checkpoints to keep, besides the best policy.
        checkpoint_every: Time between checkpoints, at least (s); it grows if writing them would take over 3 % of the
            time.
        resume: Directory of a run to continue; other settings are then taken from it.
        init: Directory of another run from whose networks the training begins; ``None`` for new ones.
    """

    robot: RobotSettings
    task: TaskSettings
    env: EnvSettings
    reward: Reward
    algo: AlgorithmSettings
    network: NetworkSettings
    exploration: ExplorationSettings
    replay: ReplaySettings
    evaluation: EvaluationSettings
    stop_when: StopWhen
    imitation: ImitationSettings = field(default_factory=ImitationSettings)
    give_up: GiveUp = field(default_factory=GiveUp)
    collector: InlineSettings | ProcessSettings = field(default_factory=InlineSettings)
    seed: int = 0
    total_frames: int = 600_000
    total_episodes: int | None = None
    time_limit: float | None = None
    rollout_steps: int = 1
    gradient_steps: int = 4
    device: str = "cpu"
    threads: int | None = None
    logger: Literal["csv", "tensorboard", "wandb", "mlflow", "none"] = "tensorboard"
    video: bool = False
    keep_checkpoints: int = 2
    checkpoint_every: float = 30.0
    resume: str | None = None
    init: str | None = None

    def __post_init__(self) -> None:
        check_between(self, 1, 10**12, "total_frames", "gradient_steps", "keep_checkpoints")
        check_between(self, 1, 100_000, "rollout_steps")
        if self.total_episodes is not None and self.total_episodes < 1:
            raise ConfigError(f"total_episodes must be at least 1, or null, got {self.total_episodes}.")
        if self.time_limit is not None and not self.time_limit > 0:
            raise ConfigError(f"time_limit must be above 0 minutes, or null, got {self.time_limit}.")
        if not self.checkpoint_every > 0:
            raise ConfigError(f"checkpoint_every must be above 0 s, got {self.checkpoint_every}.")
        check_seed("seed", self.seed)
        check_device(self.device)
        if self.threads is not None and self.threads < 1:
            raise ConfigError(f"threads must be at least 1, or null, got {self.threads}.")
        check_between(self, 1, MOST_THREADS, "threads")
        self._check_frames()

    @property
    def batch_steps(self) -> int:
        """Return the control steps of every robot that are collected at once."""
        return self.rollout_steps * self.collector.chunk

    @property
    def batch_frames(self) -> int:
        """Return the control steps of all robots together that are collected at once."""
        return self.env.num_envs * self.batch_steps

    @property
    def exploration_here(self) -> ExplorationSettings:
        """Return the settings of exploration as the collector follows them."""
        return self.exploration.in_workers if isinstance(self.collector, ProcessSettings) else self.exploration

    @property
    def batch_updates(self) -> int:
        """Return the updates of the networks after each collected batch."""
        return self.gradient_steps * self.collector.chunk

    def _check_frames(self) -> None:
        """Raise a :class:`.ConfigError` if the numbers of frames do not fit one another."""
        if self.total_frames < self.batch_frames:
            product = "env.num_envs * rollout_steps" + (" * collector.chunk" if self.collector.chunk > 1 else "")
            raise ConfigError(
                f"total_frames must be at least {product} = {self.batch_frames}, got {self.total_frames}."
            )
        self._check_warmup(self.exploration_here.rounds)
        # The newest n_step of a robot cannot be drawn yet, the oldest history - 1 no longer.
        least = self.env.num_envs * (self.task.history + self.replay.n_step)
        if self.replay.storage == "frames" and self.replay.buffer_size < least:
            raise ConfigError(
                f"replay.buffer_size must be at least env.num_envs * (task.history + replay.n_step) = {least}, "
                f"got {self.replay.buffer_size}."
            )
        drawn = self.replay.buffer_size // self.env.num_envs - self.replay.n_step - self.task.history + 1
        if self.replay.storage == "frames" and drawn * self.env.num_envs < self.replay.batch_size:
            raise ConfigError(
                f"replay.buffer_size must hold a batch: of {self.replay.buffer_size} of {self.env.num_envs} robots "
                f"{drawn * self.env.num_envs} can be drawn, replay.batch_size is {self.replay.batch_size}."
            )

    def _check_warmup(self, rounds: int) -> None:
        """Raise a :class:`.ConfigError` if the first of so many rounds of the warm-up takes all frames."""
        frames = self.exploration_here.learning_starts
        if frames // rounds > self.total_frames:
            first = f", {frames // rounds} of them in the first of {rounds} rounds" if rounds > 1 else ""
            raise ConfigError(
                f"exploration.learning_starts must be at most total_frames = {self.total_frames}, got {frames}{first}: "
                f"the training would end before it learns; exploration.learning_starts={self.total_frames // 2} leaves "
                "half of them."
            )

    def setup(self, robot: Robot | None = None) -> Setup:
        """Read the robot, build its graph and its task, and check the settings that depend on them.

        Args:
            robot: The robot, if it need not be read: the copy of a run.

        Raises:
            RobotError: If the robot cannot be used.
            ConfigError: If a setting does not fit it.
        """
        task = self.task.build(self.robot if robot is None else GivenRobot.of(self.robot, robot), self.reward)
        for key, asked, ability in (("replay.mirror", self.replay.mirror, "mirror"), ("video", self.video, "film")):
            if asked is True and ability not in task.abilities:
                raise ConfigError(f"{key} must be false for {task.name}, got true: {ability} is for simulated tasks.")
        if task.endless:
            raise ConfigError(
                "task.terminations must hold a gctd3.TimeLimit: without one an evaluation may never end, got none."
            )
        check_backend(task, self.env.backend)
        if self.env.backend != "library":
            substeps_of(task.control_dt, task.robot)
        if self.stop_when.of_motion and "film" not in task.abilities:
            raise ConfigError(
                f"stop_when must have no condition on {', '.join(RECORDED)} for {task.name}: motions are recorded of "
                f"simulated tasks, got {', '.join(name for name in RECORDED if name in self.stop_when.names)}."
            )
        self.exploration.check_robot(task.robot, task.control_dt)
        steps = self.exploration_here.learning_starts // self.env.num_envs
        self._check_warmup(self.exploration_here.rounds_of(steps * task.control_dt))
        if self.exploration.warmup in ("stepping", "swinging", "jumping") and self.env.backend == "library":
            raise ConfigError(
                f"exploration.warmup must be rhythmic or uniform for {task.name}, got {self.exploration.warmup}: "
                "motions are judged by the reward of robots that gctd3 steps itself."
            )
        try:
            task.evaluated(self.evaluation.reward)
        except ConfigError as error:
            raise ConfigError(f"evaluation.{error}") from error
        setup = Setup(task, self.network, self.algo.privileged_critic)
        if self.network.equivariant:
            _ = setup.reflection
        return setup

    def check_here(self) -> None:
        """Check the settings that depend on this machine, before anything is begun.

        Raises:
            ConfigError: If a setting does not fit it.
            PackageError: If a package is missing.
        """
        check_index(self.device)
        if self.env.backend == "dm_control":
            check_dm_control("env.backend=dm_control")
        self.collector.check_here(self.env.num_envs)
