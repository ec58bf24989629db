"""Tasks of other libraries as environments to train on: dm_control's suite and Gymnasium's MuJoCo robots."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import Literal

import torch
from tensordict import TensorDictBase
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs import (
    CatFrames,
    Compose,
    DMControlEnv,
    EnvBase,
    GymEnv,
    InitTracker,
    SelectTransform,
    SerialEnv,
    StepCounter,
    Transform,
    TransformedEnv,
)

from gctd3.envs.gait import FEATURES
from gctd3.envs.nodes import NodeSensor, sensor_of, simulator, with_nodes
from gctd3.errors import ConfigError, check_between
from gctd3.robot import Robot

MOST_ROBOTS, MOST_FRAMES = 100_000, 1000  # stepped together; stacked into an observation


@dataclass(frozen=True)
class LibrarySettings:
    """A task with its own robot, reward and endings.

    Attributes:
        library: ``dm_control`` or ``gymnasium``.
        task: ``domain-task`` of dm_control's suite, or Gymnasium's id.
        num_envs: Robots, simulated one after another.
        history: Frames stacked into an observation.
    """

    library: Literal["dm_control", "gymnasium"]
    task: str
    num_envs: int = 8
    history: int = 2

    def __post_init__(self) -> None:
        check_between(self, 1, MOST_ROBOTS, "num_envs")
        check_between(self, 1, MOST_FRAMES, "history")

    @property
    def robot(self) -> Robot:
        """The robot in the task's simulator.

        Raises:
            ConfigError: If there is no such task, or its robot does not fit.
        """
        return _probe(self.library, self.task)[0].robot

    @property
    def control_dt(self) -> float:
        """The task's control period (s)."""
        return _probe(self.library, self.task)[1]

    def judging(self, episodes: int, threads: int | None = None) -> LibrarySettings:
        """The same task for one evaluation; ``threads`` is for tasks that are simulated at once."""
        return replace(self, num_envs=episodes)

    def make(self) -> EnvBase:
        """The task as its library has it, one robot.

        Raises:
            ConfigError: If there is no such task.
        """
        try:
            if self.library == "gymnasium":
                return GymEnv(self.task)
            domain, _, task = self.task.partition("-")
            return DMControlEnv(domain, task)
        except Exception as error:  # either library has errors of its own
            raise ConfigError(f"task: {self.library} cannot make {self.task!r}: {error}") from error


class _TaskKeys(Transform):
    """What the walking task tells besides the nodes: the way forward (m); success and counters, of which is none."""

    def __init__(self, env: EnvBase, sensor: NodeSensor) -> None:
        super().__init__(in_keys=[], out_keys=["position", "success", "diverged", "counters"])
        self.__dict__["_sensor"], self.__dict__["_env"] = sensor, env

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        _, data = simulator(self._env)
        next_tensordict.set("position", torch.tensor([self._sensor.position(data)], dtype=torch.float32))
        next_tensordict.set("success", torch.zeros(1, dtype=torch.bool))
        next_tensordict.set("diverged", torch.zeros(1, dtype=torch.bool))
        return next_tensordict.set("counters", torch.zeros(0))

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        observation_spec["position"] = Unbounded((1,))
        observation_spec["success"] = Binary(1, shape=(1,), dtype=torch.bool)
        observation_spec["diverged"] = Binary(1, shape=(1,), dtype=torch.bool)
        observation_spec["counters"] = Unbounded((0,))
        return observation_spec


def build_library_env(settings: LibrarySettings, seed: int) -> EnvBase:
    """Robots of a library's task, with the keys of :func:`gctd3.envs.factory.build_env`.

    Returns:
        An environment of batch size ``[num_envs]``; ``position`` is the way forward from the origin (m), ``counters``
        is empty, ``success`` and ``diverged`` are never true.
    """

    def one(index: int) -> EnvBase:
        env = settings.make()
        noded = with_nodes(env)
        noded.append_transform(_TaskKeys(env, noded.transform[0].sensor))
        noded.append_transform(SelectTransform("nodes", "position", "success", "diverged", "counters"))
        noded.set_seed(seed + index)
        return noded

    env = SerialEnv(settings.num_envs, [lambda i=i: one(i) for i in range(settings.num_envs)])
    env.set_seed(seed)
    stack = CatFrames(N=settings.history, dim=-1, in_keys=["nodes"], padding="same")
    return TransformedEnv(env, Compose(InitTracker(), StepCounter(), stack))


@functools.lru_cache
def _probe(library: Literal["dm_control", "gymnasium"], task: str) -> tuple[NodeSensor, float]:
    env = LibrarySettings(library, task).make()
    sensor = sensor_of(env)
    if sensor.features != FEATURES:
        raise ConfigError(f"task: {task!r} has a robot with ball joints, for whose nodes there is no replay yet.")
    low, high = env.action_spec.space.low, env.action_spec.space.high
    if not (low == -1).all() or not (high == 1).all():
        raise ConfigError(f"task: actions of {task!r} must lie in [-1, 1], got {low.tolist()} to {high.tolist()}.")
    inner = env._env
    dt = inner.control_timestep() if library == "dm_control" else inner.unwrapped.dt
    env.close()
    return sensor, float(dt)
