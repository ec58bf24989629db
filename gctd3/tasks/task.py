"""The interface of tasks: a robot, its graph, the features of its nodes, backends and abilities.

Two kinds of tasks fulfil :class:`Task`: those that gctd3 simulates (:class:`.SimulatedTask`), on any backend, and those
of other libraries, which step their own simulators. Callers do not distinguish them: a task declares its backends and
its abilities.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

from gctd3.errors import ConfigError, RunError, check_between
from gctd3.robots.gait_pattern import GaitPattern
from gctd3.robots.graph import KinematicGraph
from gctd3.robots.robot import Robot
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.posture import Posture
from gctd3.tasks.reflection import Reflection
from gctd3.tasks.reward import Reward
from gctd3.tasks.terms import Array

MOST_FRAMES = 1000  # limit of frames stacked into an observation
Ability = Literal["film", "export", "robustness", "mirror", "commands"]


class Task(Protocol):
    """Represent a task on one robot.

    Attributes:
        name: Name of the task.
        robot: The robot.
        graph: Graph of the observed nodes.
        features: ``F``, features of a node in one frame.
        history: Number of frames stacked into an observation.
        control_dt: Control period (s).
        num_counters: Length of the critics' privileged input.
        backends: Backends on which the task runs; see :class:`.EnvSettings`.
        abilities: Operations that the task and its policies support.
        endless: Whether an episode may go on forever, so that it cannot be evaluated.
        gait: Gait for which the policy observes a clock, or ``None``.
    """

    name: str
    robot: Robot
    graph: KinematicGraph
    features: int
    history: int
    control_dt: float
    num_counters: int
    backends: tuple[str, ...]
    abilities: frozenset[Ability]
    endless: bool
    gait: GaitPattern | None

    @property
    def time_limit(self) -> int | None:
        """Return the control steps after which an episode ends by itself; ``None`` where another library decides."""

    @property
    def shown_command(self) -> Callable[[Array], Array] | None:
        """Return a function that reads a commanded velocity or height from observations; ``None`` without commands."""

    @property
    def shown_velocity(self) -> Callable[[Array], Array] | None:
        """Return a function that reads how a robot moves from counters; ``None`` for a task without commands."""

    @property
    def posture(self) -> Posture | None:
        """Return what shows the body's posture in observations; ``None`` where nothing does."""

    @property
    def levels(self) -> tuple[float, ...] | None:
        """Return the commanded heights of jumps, rising (m); ``None`` for a task without them."""

    def reflection(self) -> Reflection:
        """Return the reflection of the task's observations and actions.

        Raises:
            RobotError: If the robot's left and right sides are not symmetric.
        """

    def with_reward(self, reward: Reward) -> Task:
        """Return the same task under another reward; a task that brings its own takes none but an empty one.

        Raises:
            ConfigError: If the task does not take it.
        """

    def evaluated(self, reward: Reward) -> Task:
        """Return the same task as policies are evaluated on it, under a reward.

        Raises:
            ConfigError: If the task does not take the reward.
        """


@dataclass(frozen=True)
class TaskSettings(ABC):
    """Hold the settings of a task.

    Attributes:
        history: Number of frames stacked into an observation.
    """

    history: int = 5

    def __post_init__(self) -> None:
        check_between(self, 1, MOST_FRAMES, "history")

    @abstractmethod
    def build(self, robot: RobotSettings, reward: Reward | None = None) -> Task:
        """Build the task, its robot and its graph.

        Args:
            robot: The settings of the robot.
            reward: The reward; by default the paper's, or that of the library whose task it is.

        Raises:
            ConfigError: If a setting does not fit the robot.
            RobotError: If the robot cannot be used.
        """


def check_able(task: Task, ability: Ability, run: object) -> None:
    """Raise a :class:`.RunError` unless a run's task has an ability."""
    if ability not in task.abilities:
        able = "task=velocity" if ability == "commands" else "tasks that gctd3 simulates"
        raise RunError(f"{run} was trained on {task.name}: {ability} is for {able}.")


def check_backend(task: Task, backend: str) -> None:
    """Raise a :class:`.ConfigError` unless a task runs on a backend."""
    if backend not in task.backends:
        raise ConfigError(f"env.backend must be {' or '.join(task.backends)} for {task.name}, got {backend}.")
