"""What every task is: a robot, its graph, what the nodes sense, and what can be done with it.

Two kinds of tasks fulfil :class:`Task`: those that gctd3 simulates (:class:`.SimulatedTask`), on any backend, and those
of other libraries, which step their own simulators. Nobody asks which one it is: a task says on which backends it runs
and what it is able to.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal, Protocol

from gctd3.errors import ConfigError, RunError, check_between
from gctd3.robots.graph import KinematicGraph
from gctd3.robots.robot import Robot
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.reflection import Reflection
from gctd3.tasks.reward import Reward

MOST_FRAMES = 1000  # stacked into an observation
Ability = Literal["film", "export", "robustness", "mirror"]


class Task(Protocol):
    """A task on one robot.

    Attributes:
        name: What to call it.
        robot: The robot.
        graph: Of what is observed.
        features: ``F``, features of a node in one frame.
        history: Frames stacked into an observation.
        control_dt: Control period (s).
        num_counters: Length of what only critics see.
        backends: On which it runs; see :class:`.EnvSettings`.
        abilities: What can be done with it and its policies.
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

    def reflection(self) -> Reflection:
        """Return how its observations and actions look in the mirror.

        Raises:
            RobotError: If the robot is not the same on its left and its right.
        """

    def judged_by(self, reward: Reward) -> Task:
        """Return the same task under another reward; one that brings its own stays as it is."""


@dataclass(frozen=True)
class TaskSettings(ABC):
    """What is asked of a robot.

    Attributes:
        history: Frames stacked into an observation.
    """

    history: int = 5

    def __post_init__(self) -> None:
        check_between(self, 1, MOST_FRAMES, "history")

    @abstractmethod
    def build(self, robot: RobotSettings, reward: Reward) -> Task:
        """Build the task, its robot and its graph.

        Raises:
            ConfigError: If a setting does not fit the robot.
            RobotError: If the robot cannot be used.
        """


def check_able(task: Task, ability: Ability, run: object) -> None:
    """Raise a :class:`.RunError` unless a run's task is able to something."""
    if ability not in task.abilities:
        raise RunError(f"{run} was trained on {task.name}: {ability} is for tasks that gctd3 simulates.")


def check_backend(task: Task, backend: str) -> None:
    """Raise a :class:`.ConfigError` unless a task runs on a backend."""
    if backend not in task.backends:
        raise ConfigError(f"env.backend must be {' or '.join(task.backends)} for {task.name}, got {backend}.")
