"""N robots of another library's task as one TorchRL environment of batch size [N]."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from gctd3.envs.nodes import NodeSensor, simulator


def observed(env: EnvBase) -> list[str]:
    """Keys of a task's own observation."""
    return [str(key) for key in env.observation_spec.keys(True, True)]


class LibraryRobots(EnvBase):
    """A task on several robots, stepped one after another.

    What stock TorchRL makes of them with a transform for each of these keys and a :class:`torchrl.envs.SerialEnv`,
    number by number (``tests/test_library_robots.py``), in a fraction of the time: most of theirs goes into passing
    small TensorDicts around.

    Args:
        robots: The task on each, as TorchRL has it, its actions in [-1, 1].
        sensor: Reads the nodes.
        observation: ``nodes``, or ``flat`` for what the task itself gives, all of it as a single node.
        static: Whether nodes also say what they are (:meth:`.NodeSensor.static`).

    Writes, with leading dimension ``[N]``: ``nodes [nodes, F]``; ``position [1]``, the way forward (m); ``success [1]``
    and ``diverged [1]``, which are never true, and ``counters [0]``; ``sensed``, what the nodes sense, if ``nodes`` is
    or holds something else; TorchRL's reward and done keys; what :class:`torchrl.envs.InitTracker` and
    :class:`torchrl.envs.StepCounter` would: ``is_init [1]``, ``step_count [1]``. Actions: ``[A]`` in [-1, 1].

    Attributes:
        robots: See above.
        seen: What was observed last, NumPy arrays under the keys of the observation.
    """

    def __init__(
        self,
        robots: Sequence[EnvBase],
        sensor: NodeSensor,
        observation: Literal["nodes", "flat"] = "nodes",
        static: bool = False,
    ) -> None:
        n = len(robots)
        super().__init__(batch_size=torch.Size([n]))
        # Not as a ModuleList: their parameters and states are none of this module's.
        self.__dict__["robots"], self.__dict__["sensor"] = list(robots), sensor
        self._flat = observed(robots[0]) if observation == "flat" else []
        self._static = sensor.static() if static else None
        nodes, features = sensor.graph.num_nodes, sensor.features
        shape = (nodes, features + (self._static.shape[1] if self._static is not None else 0))
        if self._flat:
            shape = (1, sum(robots[0].observation_spec[key].shape.numel() for key in self._flat))
        flag = Binary(1, shape=(n, 1), dtype=torch.bool)
        spec = {"nodes": Unbounded((n, *shape)), "position": Unbounded((n, 1))}
        if self._flat or static:
            spec["sensed"] = Unbounded((n, nodes, features))
        self.seen = {key: np.zeros(one.shape, dtype=np.float32) for key, one in spec.items()}
        self.seen |= {"is_init": np.ones((n, 1), dtype=bool), "step_count": np.zeros((n, 1), dtype=np.int64)}
        self.observation_spec = Composite(
            **spec,
            counters=Unbounded((n, 0)),
            success=flag.clone(),
            diverged=flag.clone(),
            is_init=flag.clone(),
            step_count=Bounded(low=0, high=torch.iinfo(torch.int64).max, shape=(n, 1), dtype=torch.int64),
            shape=(n,),
        )
        self.action_spec = Bounded(low=-1.0, high=1.0, shape=(n, *robots[0].action_spec.shape))
        self.reward_spec = Unbounded((n, 1))
        self.done_spec = Composite(done=flag, terminated=flag.clone(), truncated=flag.clone(), shape=(n,))
        # Gymnasium's tasks reckon with the precision of the action that they get.
        self._precision = np.float64 if robots[0].action_spec.dtype == torch.float64 else np.float32

    def _see(self, index: int, observation: Any) -> None:  # noqa: ANN401 - an array or a mapping of arrays
        robot = self.robots[index]
        model, data = simulator(robot)
        sensed = self.sensor.read(model, data)
        self.seen["position"][index] = self.sensor.position(data)
        if "sensed" in self.seen:
            self.seen["sensed"][index] = sensed
        if self._flat:
            parts = robot.read_obs(observation)
            sensed = np.concatenate([np.ravel(parts[key]) for key in self._flat])[None]
        elif self._static is not None:
            sensed = np.concatenate([sensed, self._static], axis=1)
        self.seen["nodes"][index] = sensed

    def _give(self, done: dict[str, np.ndarray], **more: np.ndarray) -> TensorDictBase:
        n = len(self.robots)
        never = {key: torch.zeros(n, 1, dtype=torch.bool) for key in ("success", "diverged")}
        given = {key: torch.from_numpy(values) for key, values in {**self.seen, **done, **more}.items()}
        return TensorDict({**given, **never, "counters": torch.zeros(n, 0)}, self.batch_size)

    def _new_seen(self) -> None:
        """Leave what was given out to those who got it."""
        self.seen = {key: values.copy() for key, values in self.seen.items()}

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDictBase:
        n = len(self.robots)
        chosen = None if tensordict is None else tensordict.get("_reset", None)
        mask = np.ones((n, 1), dtype=bool) if chosen is None else chosen.reshape(n, 1).cpu().numpy()
        self._new_seen()
        for i in np.flatnonzero(mask).tolist():
            robot = self.robots[i]
            self._see(i, robot._reset_output_transform(robot._env.reset())[0])
        self.seen["is_init"] = mask.copy()
        self.seen["step_count"][mask] = 0
        ends = ("done", "terminated", "truncated")
        return self._give({key: np.zeros((n, 1), dtype=bool) for key in ends})

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        n = len(self.robots)
        actions = tensordict.get("action").detach().cpu().numpy().astype(self._precision)
        reward = np.zeros((n, 1), dtype=np.float32)
        done = {key: np.zeros((n, 1), dtype=bool) for key in ("done", "terminated", "truncated")}
        self._new_seen()
        for i, robot in enumerate(self.robots):
            observation, reward[i], *ends, _ = robot._output_transform(robot._env.step(actions[i]))
            done["terminated"][i], done["truncated"][i], done["done"][i] = ends
            self._see(i, observation)
        self.seen["is_init"] = np.zeros((n, 1), dtype=bool)
        self.seen["step_count"] += 1
        return self._give(done, reward=reward)

    def set_seed(self, seed: int | None = None, static_seed: bool = False) -> int | None:
        """Seed the robots one after another, each with what the one before makes of its own; return the next seed."""
        for robot in self.robots:
            seed = robot.set_seed(seed, static_seed=static_seed)
        return seed

    def _set_seed(self, seed: int | None) -> None:
        self.set_seed(seed)

    def close(self, *, raise_if_closed: bool = True) -> None:
        """End all of them."""
        super().close(raise_if_closed=raise_if_closed)
        for robot in self.robots:
            if not robot.is_closed:
                robot.close()
