"""Environments by name: the backend, then the transforms in their one right order."""

from __future__ import annotations

from dataclasses import dataclass, replace

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
from gctd3.envs.library import build_library_env
from gctd3.envs.serial import SerialRobots
from gctd3.envs.settings import Backend, EnvSettings, LibrarySettings
from gctd3.envs.simulation import Simulation
from gctd3.errors import ConfigError
from gctd3.robots.robot import Robot
from gctd3.tasks.reward import Reward
from gctd3.tasks.walk import WalkingTask


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
