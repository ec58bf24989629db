"""Tasks of other libraries to train on: dm_control's suite and Gymnasium's MuJoCo robots."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np
from torchrl.envs import DMControlEnv, EnvBase, GymEnv

from gctd3.compat import replace_wrapped_env, wrapped_env
from gctd3.config.requirements import check_dm_control
from gctd3.envs.library_robots import LibraryRobots, observed
from gctd3.envs.nodes import STATIC, NodeSensor, simulator
from gctd3.errors import ConfigError, check_kind
from gctd3.robots.floating_base import Axis
from gctd3.robots.gait_pattern import GaitPattern
from gctd3.robots.graph import KinematicGraph
from gctd3.robots.robot import Robot
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.reflection import Reflection
from gctd3.tasks.reward import Reward
from gctd3.tasks.task import Ability

Library = Literal["dm_control", "gymnasium"]


class LibraryTask:
    """Represent a task that another library simulates, rewards and ends, on its own robot; see :class:`.Task`.

    Args:
        library: ``dm_control`` or ``gymnasium``.
        name: ``domain-task`` of dm_control's suite, or Gymnasium's id.
        robot: Feet, forward axis and graph of the library's robot.
        history: Number of frames stacked into an observation.
        observation: ``nodes`` of the robot's graph, or ``flat`` for the task's own observation.
        static: Whether every frame of a node also has its constant features.
    """

    num_counters = 0
    gait: GaitPattern | None = None
    backends: tuple[str, ...] = ("library",)
    abilities: frozenset[Ability] = frozenset()
    endless = False
    time_limit = shown_command = shown_velocity = posture = levels = None

    def __init__(
        self,
        library: Library,
        name: str,
        robot: RobotSettings,
        history: int = 2,
        observation: Literal["nodes", "flat"] = "nodes",
        static: bool = False,
    ) -> None:
        self.library, self.name, self.history = library, name, history
        self.observation, self.static = observation, static
        probe = _probe(library, name)
        feet = None if robot.feet is None else tuple(robot.feet)
        self.robot = _robot(library, name, feet, robot.forward)
        self.control_dt = probe.control_dt
        if observation == "flat":
            self.graph, self.features = KinematicGraph(("observation",), np.zeros((1, 1))), probe.size
        else:
            self.graph = robot.graph_of(self.robot)
            self.features = NODE_FEATURES + (len(STATIC) if static else 0)

    def reflection(self) -> Reflection:
        """Return the mirror reflection of its observations and actions.

        Raises:
            ConfigError: If its nodes have other features than those of the walking task.
        """
        if self.static or self.observation == "flat":
            raise ConfigError(
                f"network.equivariant must be false for {self.name} with task.observation={self.observation} "
                f"and task.static={str(self.static).lower()}, got true."
            )
        return Reflection.from_robot(self.robot)

    def evaluated(self, reward: Reward) -> LibraryTask:
        """Return the task as it is, see :meth:`with_reward`."""
        return self.with_reward(reward)

    def with_reward(self, reward: Reward) -> LibraryTask:
        """Return the task as it is: it brings its own reward.

        Raises:
            ConfigError: If the reward has terms, which would be ignored.
        """
        check_kind("reward", reward, Reward)
        if reward.terms:
            raise ConfigError(
                f"reward.terms must be empty for {self.name}, which brings its own reward, got "
                f"{', '.join(reward.terms)}: leave out reward=... and reward.terms...=..."
            )
        return self

    def env(self, num_envs: int, seed: int) -> LibraryRobots:
        """Make an environment of ``num_envs`` robots.

        Args:
            num_envs: Number of robots.
            seed: Seed of the first robot's starts; TorchRL generates each further robot's from the one before.
        """
        robots = [make_robot(self.library, self.name) for _ in range(num_envs)]
        sensor = NodeSensor(simulator(robots[0])[0], self.robot.feet, self.robot.forward_axis)
        env = LibraryRobots(robots, sensor, self.observation, self.static)
        env.set_seed(seed)
        return env


NODE_FEATURES = 2  # of a node in one frame: a position and a velocity


def make_robot(library: Library, name: str) -> EnvBase:
    """Make a library's own environment of a task, for one robot, its actions scaled to [-1, 1].

    Raises:
        ConfigError: If there is no such task, or it cannot be scaled or is not one of MuJoCo's.
        PackageError: If dm_control is needed and cannot be imported.
    """
    if library == "dm_control":
        check_dm_control(f"library=dm_control, of {name},")
    try:
        if library == "gymnasium":
            env = GymEnv(name)
        else:
            domain, _, task = name.partition("-")
            env = DMControlEnv(domain, task)
    except Exception as error:  # either library has errors of its own
        raise ConfigError(f"name: {library} cannot make {name!r}: {error}") from error
    simulator(env)
    _scale_actions(library, name, env)
    return env


def _scale_actions(library: Library, name: str, env: EnvBase) -> None:
    """Put the library's own wrapper around a task whose actions do not lie in [-1, 1]."""
    low, high = env.action_spec.space.low, env.action_spec.space.high
    if (low == -1).all() and (high == 1).all():
        return
    # dm_control has MuJoCo's largest number where there is no limit, Gymnasium an empty range.
    if not ((low.abs() < mujoco.mjMAXVAL) & (high.abs() < mujoco.mjMAXVAL) & (low < high)).all():
        raise ConfigError(
            f"name: actions of {name!r} must have limits, to be scaled to [-1, 1], got {low.tolist()} to "
            f"{high.tolist()}."
        )
    if library == "gymnasium":
        from gymnasium.wrappers import RescaleAction

        scaled = RescaleAction(wrapped_env(env), np.float32(-1.0), np.float32(1.0))
    else:
        from dm_control.suite.wrappers import action_scale

        scaled = action_scale.Wrapper(wrapped_env(env), minimum=-1.0, maximum=1.0)
    replace_wrapped_env(env, scaled)


@dataclass(frozen=True)
class _Probe:
    """Hold facts about a task: its simulator's model, its control period (s), the size of its own observation."""

    model: mujoco.MjModel
    control_dt: float
    size: int


@functools.lru_cache
def _probe(library: Library, name: str) -> _Probe:
    env = make_robot(library, name)
    inner = wrapped_env(env)
    dt = inner.control_timestep() if library == "dm_control" else inner.unwrapped.dt
    size = sum(env.observation_spec[key].shape.numel() for key in observed(env))
    model, _ = simulator(env)
    env.close()
    return _Probe(model, float(dt), size)


@functools.lru_cache
def _robot(library: Library, name: str, feet: tuple[str, ...] | None, forward: Axis | None) -> Robot:
    sensor = NodeSensor(_probe(library, name).model, feet, forward)
    robot = sensor.robot
    if sensor.features != NODE_FEATURES:
        raise ConfigError(f"name: {name!r} has a robot with ball joints, for whose nodes there is no replay yet.")
    robot.check_legs()
    return robot
