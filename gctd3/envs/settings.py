"""Settings of the simulation and of other libraries' tasks. Light: simulators are imported when they are used."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

from gctd3.errors import ConfigError, check_between
from gctd3.tasks.reward import Endings

if TYPE_CHECKING:
    from torchrl.envs import EnvBase

    from gctd3.robots.floating_base import Axis
    from gctd3.robots.graph import KinematicGraph
    from gctd3.robots.robot import Robot

Backend = Literal["batched", "dm_control"]
Library = Literal["dm_control", "gymnasium"]
MOST_ROBOTS, MOST_FRAMES, MOST_THREADS = 100_000, 1000, 1024  # stepped together; stacked into an observation; of a pool


@dataclass(frozen=True)
class Start:
    """Set where an episode starts: :attr:`.Robot.start_qpos`, each joint off by a uniform random amount.

    Attributes:
        angle_noise: Largest deviation of a joint's angle from the pose in which episodes begin (rad).
        velocity_noise: Largest deviation of a joint's velocity from zero (rad/s).
    """

    angle_noise: float = 0.05
    velocity_noise: float = 0.1

    def __post_init__(self) -> None:
        check_between(self, 0, 10, "angle_noise")
        check_between(self, 0, 1000, "velocity_noise")


@dataclass(frozen=True)
class EnvSettings:
    """Set how the task is simulated and observed.

    Attributes:
        backend: ``batched``: all robots at once with MuJoCo (fast); ``dm_control``: one after another, as a dm_control
            task.
        num_envs: Robots that are stepped.
        history: Frames stacked into an observation (paper, section 2.3).
        control_dt: Control period (s); 50 Hz in the paper, section 3.1.
        threads: CPU threads that simulate; ``None`` for all cores. Results do not depend on it.
        check: Check every observation, action and reward against its spec (:class:`.CheckStep`); for tracking down a
            fault, it costs time.
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


@dataclass(frozen=True)
class LibrarySettings:
    """Set a task with its own robot, reward and endings.

    Attributes:
        library: ``dm_control`` or ``gymnasium``.
        task: ``domain-task`` of dm_control's suite, or Gymnasium's id; its actions are scaled to [-1, 1].
        num_envs: Robots, simulated one after another.
        history: Frames stacked into an observation.
        observation: ``nodes``: of the robot's graph (:class:`.NodeSensor`); ``flat``: what the task itself gives, all
            of it as a single node, which is for networks without graph layers.
        static: Let every frame of a node also say what it is (kind, actuated, limits, share of the mass); replay grows
            sixfold.
    """

    library: Library
    task: str
    num_envs: int = 8
    history: int = 2
    observation: Literal["nodes", "flat"] = "nodes"
    static: bool = False

    def __post_init__(self) -> None:
        check_between(self, 1, MOST_ROBOTS, "num_envs")
        check_between(self, 1, MOST_FRAMES, "history")
        if self.static and self.observation == "flat":
            raise ConfigError("static must be false for observation=flat, which has no nodes to describe, got true.")

    def load_robot(self, feet: Sequence[str] | None = None, forward: Axis | None = None) -> Robot:
        """The robot in the task's simulator.

        Args:
            feet: Names of the bodies that may touch the ground, see :meth:`.Robot.from_mjcf`.
            forward: Where forward is, likewise.

        Raises:
            ConfigError: If there is no such task, or its robot does not fit.
            RobotError: If it has no such feet.
        """
        from gctd3.envs.library import robot_of

        return robot_of(self.library, self.task, None if feet is None else tuple(feet), forward)

    @property
    def control_dt(self) -> float:
        """The task's control period (s)."""
        from gctd3.envs.library import probe

        return probe(self.library, self.task).control_dt

    @property
    def graph(self) -> KinematicGraph | None:
        """The graph of what is observed, if that is not the robot's."""
        if self.observation == "nodes":
            return None
        import numpy as np

        from gctd3.robots.graph import KinematicGraph

        return KinematicGraph(("observation",), np.zeros((1, 1)))

    @property
    def features(self) -> int:
        """``F``, features of a node in one frame."""
        from gctd3.envs.library import probe
        from gctd3.envs.nodes import STATIC
        from gctd3.tasks.walk import FEATURES

        if self.observation == "flat":
            return probe(self.library, self.task).size
        return FEATURES + (len(STATIC) if self.static else 0)

    def judging(self, episodes: int, threads: int | None = None) -> LibrarySettings:
        """The same task for one evaluation; ``threads`` is for tasks that are simulated at once."""
        return replace(self, num_envs=episodes)

    def make(self) -> EnvBase:
        """The task as its library has it; see :func:`.make_task`."""
        from gctd3.envs.library import make_task

        return make_task(self.library, self.task)
