"""Tasks of other libraries as environments to train on: dm_control's suite and Gymnasium's MuJoCo robots."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import mujoco
import numpy as np
from torchrl.envs import CatFrames, Compose, DMControlEnv, EnvBase, GymEnv, TransformedEnv

from gctd3.envs.library_robots import LibraryRobots, observed
from gctd3.envs.nodes import STATIC, NodeSensor, simulator
from gctd3.errors import ConfigError, check_between
from gctd3.robots.floating_base import Axis
from gctd3.robots.graph import KinematicGraph
from gctd3.robots.robot import Robot
from gctd3.tasks.walk import FEATURES

Library = Literal["dm_control", "gymnasium"]
MOST_ROBOTS, MOST_FRAMES = 100_000, 1000  # stepped together; stacked into an observation


@dataclass(frozen=True)
class LibrarySettings:
    """A task with its own robot, reward and endings.

    Attributes:
        library: ``dm_control`` or ``gymnasium``.
        task: ``domain-task`` of dm_control's suite, or Gymnasium's id; its actions are scaled to [-1, 1].
        num_envs: Robots, simulated one after another.
        history: Frames stacked into an observation.
        observation: ``nodes``: of the robot's graph, see :class:`.NodeSensor`; ``flat``: what the task itself gives,
            all of it as a single node, which is for networks without graph layers.
        static: Whether every frame of a node also says what it is (:meth:`.NodeSensor.static`).
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
        return _robot(self.library, self.task, None if feet is None else tuple(feet), forward)

    @property
    def control_dt(self) -> float:
        """The task's control period (s)."""
        return _probe(self.library, self.task).control_dt

    @property
    def graph(self) -> KinematicGraph | None:
        """The graph of what is observed, if that is not the robot's."""
        return KinematicGraph(("observation",), np.zeros((1, 1))) if self.observation == "flat" else None

    @property
    def features(self) -> int:
        """``F``, features of a node in one frame."""
        if self.observation == "flat":
            return _probe(self.library, self.task).size
        return FEATURES + (len(STATIC) if self.static else 0)

    def judging(self, episodes: int, threads: int | None = None) -> LibrarySettings:
        """The same task for one evaluation; ``threads`` is for tasks that are simulated at once."""
        return replace(self, num_envs=episodes)

    def make(self) -> EnvBase:
        """The task as its library has it, one robot, its actions scaled to [-1, 1].

        Raises:
            ConfigError: If there is no such task, or it cannot be scaled or is not one of MuJoCo's.
        """
        try:
            if self.library == "gymnasium":
                env = GymEnv(self.task)
            else:
                domain, _, task = self.task.partition("-")
                env = DMControlEnv(domain, task)
        except Exception as error:  # either library has errors of its own
            raise ConfigError(f"task: {self.library} cannot make {self.task!r}: {error}") from error
        simulator(env)
        self._scale_actions(env)
        return env

    def _scale_actions(self, env: EnvBase) -> None:
        """Put the library's own wrapper around a task whose actions do not lie in [-1, 1]."""
        low, high = env.action_spec.space.low, env.action_spec.space.high
        if (low == -1).all() and (high == 1).all():
            return
        # dm_control has MuJoCo's largest number where there is no limit, Gymnasium an empty range.
        if not ((low.abs() < mujoco.mjMAXVAL) & (high.abs() < mujoco.mjMAXVAL) & (low < high)).all():
            raise ConfigError(
                f"task: actions of {self.task!r} must have limits, to be scaled to [-1, 1], got {low.tolist()} to "
                f"{high.tolist()}."
            )
        if self.library == "gymnasium":
            from gymnasium.wrappers import RescaleAction

            env._env = RescaleAction(env._env, np.float32(-1.0), np.float32(1.0))
        else:
            from dm_control.suite.wrappers import action_scale

            env._env = action_scale.Wrapper(env._env, minimum=-1.0, maximum=1.0)
        env._make_specs(env._env)


def build_library_env(robot: Robot, settings: LibrarySettings, seed: int) -> EnvBase:
    """Robots of a library's task, with the keys of :func:`gctd3.envs.factory.build_env`.

    Args:
        robot: The task's own, which knows its feet and where forward is: of :meth:`LibrarySettings.load_robot`.
        settings: Which task.
        seed: Of the first robot's starts; the next one's is one more.

    Returns:
        An environment of batch size ``[num_envs]``; ``position`` is the way forward from the origin (m), ``counters``
        is empty, ``success`` and ``diverged`` are never true. If ``nodes`` is flat, or holds more than what the nodes
        sense, ``sensed`` is that.
    """
    robots = [settings.make() for _ in range(settings.num_envs)]
    sensor = NodeSensor(simulator(robots[0])[0], robot.feet, robot.forward_axis)
    env = LibraryRobots(robots, sensor, settings.observation, settings.static)
    env.set_seed(seed)
    stack = CatFrames(N=settings.history, dim=-1, in_keys=["nodes"], padding="same")
    return TransformedEnv(env, Compose(stack))


@dataclass(frozen=True)
class _Probe:
    """What a task is found to be: its simulator's model, its control period (s), the size of its own observation."""

    model: mujoco.MjModel
    control_dt: float
    size: int


@functools.lru_cache
def _probe(library: Library, task: str) -> _Probe:
    env = LibrarySettings(library, task).make()
    inner = env._env
    dt = inner.control_timestep() if library == "dm_control" else inner.unwrapped.dt
    size = sum(env.observation_spec[key].shape.numel() for key in observed(env))
    model, _ = simulator(env)
    env.close()
    return _Probe(model, float(dt), size)


@functools.lru_cache
def _robot(library: Library, task: str, feet: tuple[str, ...] | None, forward: Axis | None) -> Robot:
    sensor = NodeSensor(_probe(library, task).model, feet, forward)
    robot = sensor.robot
    if sensor.features != FEATURES:
        raise ConfigError(f"task: {task!r} has a robot with ball joints, for whose nodes there is no replay yet.")
    robot.check_legs()
    return robot
