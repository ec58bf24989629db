"""Environments by name: the backend, then the transforms in their one right order."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from torchrl.envs import (
    CatFrames,
    Compose,
    DoubleToFloat,
    EnvBase,
    InitTracker,
    StepCounter,
    TransformedEnv,
)

from gctd3.envs.check import CheckStep
from gctd3.envs.library import MOST_FRAMES, MOST_ROBOTS, LibrarySettings, build_library_env
from gctd3.envs.serial import SerialRobots
from gctd3.envs.simulation import Simulation, Start
from gctd3.errors import ConfigError, check_between
from gctd3.robots.robot import Robot
from gctd3.tasks.reward import Endings, Reward
from gctd3.tasks.walk import WalkingTask

Backend = Literal["batched", "dm_control"]
MOST_THREADS = 1024


@dataclass(frozen=True)
class EnvSettings:
    """How the task is simulated and observed.

    Attributes:
        backend: ``batched`` steps all robots at once with MuJoCo; ``dm_control`` one after another with dm_control.
        num_envs: Robots.
        history: Frames stacked into an observation.
        control_dt: Control period (s).
        threads: Of the batched backend; all cores if ``None``.
        check: Whether every step is checked by :class:`.CheckStep`.
        start: Where episodes start.
        endings: When they end.
    """

    backend: Backend = "batched"
    num_envs: int = 64
    history: int = 5
    control_dt: float = 0.02
    threads: int | None = None
    check: bool = False
    start: Start = field(default_factory=Start)
    endings: Endings = field(default_factory=Endings)

    def __post_init__(self) -> None:
        check_between(self, 1, MOST_ROBOTS, "num_envs")
        check_between(self, 1, MOST_FRAMES, "history")
        if self.threads is not None and self.threads < 1:
            raise ConfigError(f"threads must be at least 1, or null for all cores, got {self.threads}.")
        check_between(self, 1, MOST_THREADS, "threads")
        if not 0 < self.control_dt <= 1:
            raise ConfigError(f"control_dt must be above 0 s and at most 1 s, got {self.control_dt}.")

    def judging(self, episodes: int, threads: int | None = None) -> EnvSettings:
        """The same task for one evaluation: a robot for each episode, all at once."""
        return replace(self, backend="batched", num_envs=episodes, threads=threads)


def build_env(robot: Robot, settings: EnvSettings | LibrarySettings, reward: Reward, seed: int) -> EnvBase:
    """The walking task on a robot, or a library's task on its own, whose reward is its own too.

    Returns:
        An environment of batch size ``[num_envs]`` that writes ``nodes [N, 2 * history]`` (oldest frame first),
        ``counters``, ``position`` (m), ``success``, ``is_init`` and ``step_count``.

    Raises:
        ConfigError: If a setting is out of range, or the robot does not fit the task.
    """
    if isinstance(settings, LibrarySettings):
        return build_library_env(robot, settings, seed)
    task = WalkingTask(robot, reward, settings.endings, settings.control_dt)
    env: EnvBase
    if settings.backend == "batched":
        from gctd3.envs.batched import BatchedEnv

        env = BatchedEnv(Simulation(task, settings.num_envs, settings.start, seed, settings.threads))
        extras = []
    elif settings.backend == "dm_control":
        from gctd3.envs import dmc

        def make(index: int) -> EnvBase:
            return dmc.torchrl_env(task, settings.start, seed + index)

        env = SerialRobots(settings.num_envs, [lambda i=i: make(i) for i in range(settings.num_envs)])
        extras = [DoubleToFloat(), InitTracker(), StepCounter()]
    else:
        raise ConfigError(f"backend must be batched or dm_control, got {settings.backend!r}.")
    stack = CatFrames(N=settings.history, dim=-1, in_keys=["nodes"], padding="same")
    checks = [CheckStep()] if settings.check else []
    return TransformedEnv(env, Compose(*extras, stack, *checks))


@dataclass(frozen=True)
class EnvRecipe:
    """All that it takes to make an environment, in another process too.

    Attributes:
        robot: The robot.
        settings: How it is simulated.
        reward: Of the walking task.
    """

    robot: Robot
    settings: EnvSettings | LibrarySettings
    reward: Reward

    def share(self, num_envs: int, threads: int) -> EnvRecipe:
        """Return the recipe for some of the robots, simulated by ``threads`` threads."""
        settings = replace(self.settings, num_envs=num_envs)
        if isinstance(settings, EnvSettings):
            settings = replace(settings, threads=threads)
        return replace(self, settings=settings)

    def make(self, seed: int) -> EnvBase:
        """Make the environment; see :func:`build_env`."""
        return build_env(self.robot, self.settings, self.reward, seed)


def make_env(
    robot: str = "biped",
    num_envs: int = 64,
    backend: Backend = "batched",
    history: int = 5,
    seed: int = 0,
    reward: Reward | None = None,
) -> EnvBase:
    """The walking task by the name of a robot, or the path of its MJCF; see :func:`build_env`.

    Example:
        >>> env = make_env("biped", num_envs=3, seed=0)
        >>> env.reset()["nodes"].shape
        torch.Size([3, 8, 10])
    """
    settings = EnvSettings(backend=backend, num_envs=num_envs, history=history)
    return build_env(Robot.from_mjcf(robot), settings, reward if reward is not None else Reward(), seed)
