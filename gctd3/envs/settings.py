"""Settings of environments: where robots are stepped, and the tasks of other libraries."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from gctd3.errors import ConfigError, check_between
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.reward import Reward
from gctd3.tasks.task import Task, TaskSettings

Backend = Literal["batched", "dm_control", "library"]
Library = Literal["dm_control", "gymnasium"]
MOST_ROBOTS = 100_000  # stepped together
MOST_THREADS = 1024


@dataclass(frozen=True)
class EnvSettings:
    """Hold the settings of an environment: where and how many robots are stepped.

    Attributes:
        backend: ``batched`` steps all robots at once with MuJoCo; ``dm_control`` one after another with dm_control;
            ``library`` is for tasks of other libraries, which step robots themselves.
        num_envs: Number of robots simulated side by side.
        threads: Threads of the batched backend; all cores if ``None``. Results do not depend on it.
        check: Whether every step is checked by :class:`.CheckStep`.
    """

    backend: Backend = "batched"
    num_envs: int = 64
    threads: int | None = None
    check: bool = False

    def __post_init__(self) -> None:
        check_between(self, 1, MOST_ROBOTS, "num_envs")
        if self.threads is not None and self.threads < 1:
            raise ConfigError(f"threads must be at least 1, or null for all cores, got {self.threads}.")
        check_between(self, 1, MOST_THREADS, "threads")

    def for_evaluation(self, episodes: int, threads: int | None = None) -> EnvSettings:
        """Return the settings for one evaluation: one robot per episode, all stepped at once where possible."""
        backend = "batched" if self.backend == "dm_control" else self.backend
        return replace(self, backend=backend, num_envs=episodes, threads=threads)

    def share(self, num_envs: int, threads: int) -> EnvSettings:
        """Return the settings for some of the robots, stepped by ``threads`` threads."""
        return replace(self, num_envs=num_envs, threads=threads)


@dataclass(frozen=True, kw_only=True)
class LibrarySettings(TaskSettings):
    """Hold the settings of a task of another library, with its own robot, reward and terminations.

    Attributes:
        library: ``dm_control`` or ``gymnasium``.
        name: ``domain-task`` of dm_control's suite, or Gymnasium's id; its actions are scaled to [-1, 1].
        history: Number of frames stacked into an observation.
        observation: ``nodes`` of the robot's graph, see :class:`.NodeSensor`, or ``flat`` for the task's own
            observation as a single node, which is for networks without graph layers.
        static: Whether every frame of a node also has its constant features (:meth:`.NodeSensor.static`).
    """

    library: Library
    name: str
    history: int = 2
    observation: Literal["nodes", "flat"] = "nodes"
    static: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.static and self.observation == "flat":
            raise ConfigError("static must be false for observation=flat, which has no nodes to describe, got true.")

    def build(self, robot: RobotSettings, reward: Reward | None = None) -> Task:
        """Build the task, its robot and its graph; the reward is the library's.

        Raises:
            ConfigError: If there is no such task, or its robot does not fit, or another robot or reward is asked for.
            RobotError: If it has no such feet.
        """
        if robot.name != RobotSettings.name:
            raise ConfigError(
                f"robot.name must be left at {RobotSettings.name} for a library's task, got {robot.name!r}: "
                "the task brings its own robot, to which robot.feet, robot.forward and robot.graph apply."
            )
        from gctd3.envs.library import LibraryTask

        task = LibraryTask(self.library, self.name, robot, self.history, self.observation, self.static)
        return task if reward is None else task.with_reward(reward)
