"""Tasks of other libraries as environments to train on: dm_control's suite and Gymnasium's MuJoCo robots."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from torchrl.envs import CatFrames, Compose, DMControlEnv, EnvBase, GymEnv, TransformedEnv

from gctd3.envs.library_robots import LibraryRobots, observed
from gctd3.envs.nodes import NodeSensor, simulator
from gctd3.errors import ConfigError
from gctd3.robots.floating_base import Axis
from gctd3.robots.robot import Robot
from gctd3.tasks.walk import FEATURES

if TYPE_CHECKING:
    from gctd3.envs.settings import Library, LibrarySettings


def make_task(library: Library, task: str) -> EnvBase:
    """The task as its library has it, one robot, its actions scaled to [-1, 1].

    Raises:
        ConfigError: If there is no such task, or it cannot be scaled or is not one of MuJoCo's.
    """
    try:
        if library == "gymnasium":
            env = GymEnv(task)
        else:
            domain, _, name = task.partition("-")
            env = DMControlEnv(domain, name)
    except Exception as error:  # either library has errors of its own
        raise ConfigError(f"task: {library} cannot make {task!r}: {error}") from error
    simulator(env)
    _scale_actions(library, task, env)
    return env


def _scale_actions(library: Library, task: str, env: EnvBase) -> None:
    """Put the library's own wrapper around a task whose actions do not lie in [-1, 1]."""
    low, high = env.action_spec.space.low, env.action_spec.space.high
    if (low == -1).all() and (high == 1).all():
        return
    # dm_control has MuJoCo's largest number where there is no limit, Gymnasium an empty range.
    if not ((low.abs() < mujoco.mjMAXVAL) & (high.abs() < mujoco.mjMAXVAL) & (low < high)).all():
        raise ConfigError(
            f"task: actions of {task!r} must have limits, to be scaled to [-1, 1], got {low.tolist()} to "
            f"{high.tolist()}."
        )
    if library == "gymnasium":
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
class Probe:
    """What a task is found to be: its simulator's model, its control period (s), the size of its own observation."""

    model: mujoco.MjModel
    control_dt: float
    size: int


@functools.lru_cache
def probe(library: Library, task: str) -> Probe:
    """Find out what a task is; once for each."""
    env = make_task(library, task)
    inner = env._env
    dt = inner.control_timestep() if library == "dm_control" else inner.unwrapped.dt
    size = sum(env.observation_spec[key].shape.numel() for key in observed(env))
    model, _ = simulator(env)
    env.close()
    return Probe(model, float(dt), size)


@functools.lru_cache
def robot_of(library: Library, task: str, feet: tuple[str, ...] | None, forward: Axis | None) -> Robot:
    """Read the robot in a task's simulator; see :meth:`.LibrarySettings.load_robot`."""
    sensor = NodeSensor(probe(library, task).model, feet, forward)
    robot = sensor.robot
    if sensor.features != FEATURES:
        raise ConfigError(f"task: {task!r} has a robot with ball joints, for whose nodes there is no replay yet.")
    robot.check_legs()
    return robot
