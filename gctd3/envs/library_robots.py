"""N robots of another library's task as one TorchRL environment of batch size [N]."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import EnvBase

from gctd3.compat import hide, reset_outcome, step_outcome, wrapped_env
from gctd3.envs.nodes import NodeSensor, simulator
from gctd3.envs.robot_state import load_robot_state, robot_state
from gctd3.envs.robots_env import Glance, RobotsEnv, column, ends
from gctd3.robots.nodes import foot_slots


def observed(env: EnvBase) -> list[str]:
    """Return the keys of a task's own observation."""
    return [str(key) for key in env.observation_spec.keys(True, True)]


class LibraryRobots(RobotsEnv):
    """Step a task on several robots, one after another.

    Every number equals that of stock TorchRL with a transform for each of the keys and a
    :class:`torchrl.envs.SerialEnv` (``tests/envs/test_library_robots.py``), in a fraction of the time: stock TorchRL
    spends most of its time passing small TensorDicts around.

    Args:
        robots: TorchRL environments of the task, one per robot, with actions in [-1, 1].
        sensor: Sensor that reads the nodes.
        observation: ``nodes``, or ``flat`` for the task's own observation as a single node.
        static: Whether nodes also have their constant features (:meth:`.NodeSensor.static`).

    Writes the keys of every :class:`.RobotsEnv`: ``position``, the forward distance from the world's origin;
    ``success`` and ``diverged``, which are never true; ``counters``, which is empty.

    Attributes:
        robots: The argument of this name.
        seen: The last observation, NumPy arrays under the keys of the observation.
    """

    def __init__(
        self,
        robots: Sequence[EnvBase],
        sensor: NodeSensor,
        observation: Literal["nodes", "flat"] = "nodes",
        static: bool = False,
    ) -> None:
        n, own = len(robots), observed(robots[0]) if observation == "flat" else []
        says = sensor.static() if static else None
        sensed = sensor.graph.num_nodes, sensor.features
        nodes = sensed if says is None else (sensed[0], sensed[1] + says.shape[1])
        if own:
            nodes = 1, sum(robots[0].observation_spec[key].shape.numel() for key in own)
        super().__init__(n, nodes, 0, robots[0].action_spec.shape[-1])
        self._flat, self._static = own, says
        # Not as a ModuleList: their parameters and states do not belong to this module.
        hide(self, robots=list(robots), sensor=sensor)
        self.seen = {"nodes": np.zeros((n, *nodes), np.float32), "position": np.zeros((n, 1), np.float32)}
        self.seen |= {"is_init": np.ones((n, 1), dtype=bool), "step_count": np.zeros((n, 1), dtype=np.int64)}
        # The nodes' features from the sensor, even if the observation is flat.
        self.sensed = np.zeros((n, *sensed), np.float32)
        # Gymnasium's tasks compute in the precision of their action.
        self._precision = np.float64 if robots[0].action_spec.dtype == torch.float64 else np.float32

    def _see(self, index: int, observation: Any) -> None:  # noqa: ANN401 - an array or a mapping of arrays
        robot = self.robots[index]
        model, data = simulator(robot)
        sensed = self.sensor.read(model, data)
        self.seen["position"][index] = self.sensor.position(data)
        self.sensed[index] = sensed
        if self._flat:
            parts = robot.read_obs(observation)
            sensed = np.concatenate([np.ravel(parts[key]) for key in self._flat])[None]
        elif self._static is not None:
            sensed = np.concatenate([sensed, self._static], axis=1)
        self.seen["nodes"][index] = sensed

    def _give(self, terminated: np.ndarray, truncated: np.ndarray, **more: torch.Tensor) -> TensorDictBase:
        n = len(self.robots)
        never = {key: torch.zeros(n, 1, dtype=torch.bool) for key in ("success", "diverged")}
        given = {key: torch.from_numpy(values) for key, values in self.seen.items()}
        rest = {**never, **ends(terminated, truncated), **more, "counters": torch.zeros(n, 0)}
        return TensorDict({**given, **rest}, self.batch_size)

    def _new_seen(self) -> None:
        """Copy the buffers, so that observations handed out before stay unchanged."""
        self.seen = {key: values.copy() for key, values in self.seen.items()}

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDictBase:
        mask = self.chosen(tensordict)
        self._new_seen()
        for i in np.flatnonzero(mask).tolist():
            robot = self.robots[i]
            self._see(i, reset_outcome(robot, wrapped_env(robot).reset())[0])
        self.seen["is_init"][:, 0] = mask
        self.seen["step_count"][mask] = 0
        nobody = np.zeros_like(mask)
        return self._give(nobody, nobody)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        n = len(self.robots)
        actions = tensordict.get("action").detach().cpu().numpy().astype(self._precision)
        reward, terminated, truncated = np.zeros(n, np.float32), np.zeros(n, bool), np.zeros(n, bool)
        self._new_seen()
        for i, robot in enumerate(self.robots):
            outcome = step_outcome(robot, wrapped_env(robot).step(actions[i]))
            observation, reward[i], terminated[i], truncated[i], *_ = outcome
            self._see(i, observation)
        self.seen["is_init"][:] = False
        self.seen["step_count"] += 1
        return self._give(terminated, truncated, reward=column(reward))

    def set_seed(self, seed: int | None = None, static_seed: bool = False) -> int | None:
        """Seed the robots one after another, each with the seed that the one before returns; return the last one's."""
        for robot in self.robots:
            seed = robot.set_seed(seed, static_seed=static_seed)
        return seed

    def _set_seed(self, seed: int | None) -> None:
        self.set_seed(seed)

    def glance(self) -> Glance:
        """Return the present measurements of the robots; ball joints are not hips."""
        robot, graph, half = self.sensor.robot, self.sensor.graph, self.sensor.features // 2
        hips = [graph.nodes.index(hip.name) for hip in robot.hips]
        node, place = foot_slots(robot).T
        # The second of a ground node's two contacts is in the velocities' half.
        return Glance(
            self.sensed[:, 0, 0], self.sensed[:, hips, 0] * robot.hip_signs, self.sensed[:, node, place * half] > 0.5
        )

    def checkpoint(self) -> dict[str, Any]:
        """Return the states of the simulators and tasks, and the last observation."""
        seen = {key: np.array(values) for key, values in self.seen.items()}
        return {"robots": [robot_state(robot) for robot in self.robots], "seen": seen, "sensed": self.sensed.copy()}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore the state returned by :meth:`checkpoint`."""
        for robot, one in zip(self.robots, state["robots"], strict=True):
            load_robot_state(robot, one)
        self.seen = {key: np.array(values) for key, values in state["seen"].items()}
        self.sensed = np.array(state["sensed"])

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Close the environments of all robots."""
        super().close(raise_if_closed=raise_if_closed)
        for robot in self.robots:
            if not robot.is_closed:
                robot.close()
