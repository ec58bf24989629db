"""Environments by name: the backend, then the transforms in their one right order."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from torchrl.envs import (
    CatFrames,
    Compose,
    DoubleToFloat,
    EnvBase,
    InitTracker,
    RewardSum,
    StepCounter,
    Transform,
    TransformedEnv,
)

from gctd3.envs.asked import AnyRobot, ask
from gctd3.envs.batched import BatchedEnv
from gctd3.envs.check import CheckStep
from gctd3.envs.serial import SerialRobots
from gctd3.envs.settings import Backend, EnvSettings
from gctd3.envs.simulation import Simulation
from gctd3.errors import ConfigError, suggest
from gctd3.robots.floating_base import Axis
from gctd3.tasks.reward import Reward
from gctd3.tasks.task import Task, TaskSettings, check_backend
from gctd3.tasks.terms import Termination

# An environment of one batch dimension, and the transforms that write the common keys which it lacks.
Made = tuple[EnvBase, list[Transform]]


def _batched(task: Any, settings: EnvSettings, seed: int) -> Made:  # noqa: ANN401 - each backend takes its own tasks
    return BatchedEnv(Simulation(task, settings.num_envs, seed, settings.threads)), [RewardSum()]


def _dm_control(task: Any, settings: EnvSettings, seed: int) -> Made:  # noqa: ANN401
    from gctd3.envs import dmc  # late: it takes long, and not every machine has it

    def make(index: int) -> EnvBase:
        return dmc.torchrl_env(task, seed + index)

    robots = SerialRobots(settings.num_envs, [lambda i=i: make(i) for i in range(settings.num_envs)])
    return robots, [DoubleToFloat(), InitTracker(), StepCounter(), RewardSum()]


def _library(task: Any, settings: EnvSettings, seed: int) -> Made:  # noqa: ANN401
    return task.env(settings.num_envs, seed), []


BACKENDS: dict[Backend, Callable[[Any, EnvSettings, int], Made]] = {
    "batched": _batched,
    "dm_control": _dm_control,
    "library": _library,
}


def build_env(task: Task, settings: EnvSettings, seed: int) -> EnvBase:
    """Build an environment of a task.

    Returns:
        An environment of batch size ``[num_envs]`` that writes ``nodes [N, F * history]`` (oldest frame first),
        ``counters``, ``position`` (m), ``success``, ``diverged``, ``is_init`` and ``step_count``, and for robots that
        gctd3 steps itself ``episode_reward``, the sum of the episode's rewards so far.

    Raises:
        ConfigError: If the task does not run on the backend, or a setting does not fit its robot.
    """
    check_backend(task, settings.backend)
    env, transforms = BACKENDS[settings.backend](task, settings, seed)
    stack = CatFrames(N=task.history, dim=-1, in_keys=["nodes"], padding="same")
    checks = [CheckStep()] if settings.check else []
    return TransformedEnv(env, Compose(*transforms, stack, *checks))


@dataclass(frozen=True)
class EnvRecipe:
    """Hold the recipe of an environment, to make it in another process too.

    Attributes:
        task: The task.
        settings: The environment's settings.
    """

    task: Task
    settings: EnvSettings

    def share(self, num_envs: int, threads: int) -> EnvRecipe:
        """Return the recipe for some of the robots, stepped by ``threads`` threads."""
        return replace(self, settings=self.settings.share(num_envs, threads))

    def make(self, seed: int) -> EnvBase:
        """Make the environment; see :func:`build_env`."""
        return build_env(self.task, self.settings, seed)


def make_env(
    robot: AnyRobot = "biped",
    num_envs: int = 64,
    backend: Backend = "batched",
    history: int | None = None,
    seed: int = 0,
    reward: Reward | str | None = None,
    task: TaskSettings | None = None,
    *,
    control_dt: float | None = None,
    feet: Sequence[str] | None = None,
    forward: Axis | None = None,
    terminations: Mapping[str, Termination | None] | None = None,
    overrides: Sequence[str] = (),
    threads: int | None = None,
    check: bool = False,
) -> EnvBase:
    """Make an environment of a robot, with the meaning that the command line has; see :func:`build_env`.

    Args:
        robot: What ``robot=`` takes, or a robot or a compiled model in memory; see :func:`.ask`.
        num_envs: Number of robots simulated side by side.
        backend: ``batched`` or ``dm_control``; ``library`` for a task of another library.
        history: Number of frames stacked into an observation; the task's by default.
        seed: Seed of the starts.
        reward: The reward, or the name of an option of ``reward=``; the paper's by default.
        task: The settings of the task; the robot's own by default.
        control_dt: Control period (s); the task's by default.
        feet: Bodies that may touch the ground.
        forward: Forward direction: x, -x, y or -y.
        terminations: Terminations besides the task's, or in their place; ``None`` leaves one out.
        overrides: Further arguments of the command line, on robot, task and reward.
        threads: Threads of the batched backend; all cores if ``None``.
        check: Whether every step is checked by :class:`.CheckStep`.

    Raises:
        ConfigError: If an argument is not what is expected, or does not fit the robot.
        RobotError: If the robot cannot be used.

    Example:
        >>> env = make_env("biped", num_envs=3, seed=0)
        >>> env.reset()["nodes"].shape
        torch.Size([3, 8, 10])
    """
    if backend not in BACKENDS:
        raise ConfigError(f"backend must be {', '.join(BACKENDS)}, got {backend!r}.{suggest(backend, BACKENDS)}")
    settings = EnvSettings(backend=backend, num_envs=num_envs, threads=threads, check=check)
    built = ask(
        robot,
        task,
        reward,
        history=history,
        control_dt=control_dt,
        feet=feet,
        forward=forward,
        terminations=terminations,
        overrides=overrides,
    )
    return build_env(built, settings, seed)
