"""Gymnasium environments whose observation is a ``Dict`` with an entry for each node of the robot's graph."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any, cast

import gymnasium
import mujoco
import numpy as np
from gymnasium.spaces import Box, Dict
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorEnv, VectorObservationWrapper
from gymnasium.vector.utils import batch_space

from gctd3.envs.gym import node_box
from gctd3.envs.nodes import NodeSensor
from gctd3.errors import ConfigError
from gctd3.robots.floating_base import Axis
from gctd3.robots.graph import KinematicGraph

OWN = "observation"


class NodeObservation(gymnasium.Wrapper[dict[str, np.ndarray], Any, Any, Any], RecordConstructorArgs):
    """Observe every node of the robot's graph under its name.

    Args:
        env: One of Gymnasium's MuJoCo robots, whose nodes :class:`.NodeSensor` reads from its simulator, or one of
            gctd3's, whose observation holds the nodes already.
        history: ``H``, number of frames stacked, for Gymnasium's robots; gctd3's have an argument of this name.
        static: Whether to append :meth:`.NodeSensor.static` to the frames, for Gymnasium's robots.
        own: Whether to keep the task's own observation too, under ``observation``, for Gymnasium's robots.
        feet: See :class:`.NodeSensor`.
        forward: See :class:`.NodeSensor`.

    Attributes:
        graph: The robot's graph.
        sensor: Sensor that reads the nodes; ``None`` for gctd3's robots.

    Observation: for each node ``float32 [F * history]``, oldest frame first; at the start of an episode all frames are
    its first.

    Raises:
        ConfigError: If the environment has no MuJoCo robot, or an argument does not fit it.
        RobotError: If the simulated model is not a robot, or has no such feet.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        history: int = 1,
        static: bool = False,
        own: bool = False,
        feet: Sequence[str] | None = None,
        forward: Axis | None = None,
    ) -> None:
        given: dict[str, Any] = {"history": history, "static": static, "own": own, "feet": feet, "forward": forward}
        RecordConstructorArgs.__init__(self, **given)
        super().__init__(env)
        if history < 1:
            raise ConfigError(f"history must be at least 1, got {history}.")
        inner: Any = env.unwrapped
        self.sensor: NodeSensor | None = None
        self._own = own
        if isinstance(graph := getattr(inner, "graph", None), KinematicGraph):
            if idle := [
                f"{name}={value!r}" for name, value in given.items() if value and (name, value) != ("history", 1)
            ]:
                raise ConfigError(
                    f"NodeObservation takes no {', '.join(idle)} here: the environment has its own nodes."
                )
            self.graph = graph
            self.observation_space = cast(Any, node_space(graph, env.observation_space))
            return
        if not isinstance(getattr(inner, "model", None), mujoco.MjModel):
            raise ConfigError(
                f"Nodes are read from gctd3's environments or Gymnasium's MuJoCo robots, got {type(inner).__name__}."
            )
        self.sensor = NodeSensor(inner.model, feet, forward)
        self.graph = self.sensor.graph
        if own and OWN in self.graph.nodes:
            raise ConfigError(f"own must be false for a robot with a node {OWN!r}, got true.")
        self._static = self.sensor.static() if static else np.zeros((self.graph.num_nodes, 0), np.float32)
        self._frames: deque[np.ndarray] = deque(maxlen=history)
        width = history * self.sensor.features + self._static.shape[1]
        spaces: dict[str, gymnasium.Space[Any]] = {name: node_box(width) for name in self.graph.nodes}
        self.observation_space = cast(Any, Dict({**spaces, OWN: env.observation_space} if own else spaces))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        if self.sensor is not None:
            self._frames.extend([self._frame()] * cast(int, self._frames.maxlen))
        return self._observe(observation), info

    def step(self, action: Any) -> tuple[dict[str, np.ndarray], Any, bool, bool, dict[str, Any]]:  # noqa: ANN401
        """Take one control step."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if self.sensor is not None:
            self._frames.append(self._frame())
        return self._observe(observation), reward, terminated, truncated, info

    def _frame(self) -> np.ndarray:
        inner: Any = self.env.unwrapped
        return cast(NodeSensor, self.sensor).read(inner.model, inner.data)

    def _observe(self, observation: Any) -> dict[str, np.ndarray]:  # noqa: ANN401 - the environment's own
        if self.sensor is None:
            return by_node(self.graph, observation)
        nodes = by_node(self.graph, np.concatenate([*self._frames, self._static], axis=1))
        return {**nodes, OWN: observation} if self._own else nodes


class VectorNodeObservation(VectorObservationWrapper):
    """Observe every node of all robots of gctd3 that are stepped at once, under the node's name.

    Gymnasium's own robots are wrapped one by one: ``gymnasium.make_vec(NAME, num_envs=N, wrappers=[NodeObservation])``.

    Args:
        env: One of gctd3's vector environments.

    Attributes:
        graph: The robots' graph.

    Observation: for each node ``float32 [num_envs, F * history]``, oldest frame first.

    Raises:
        ConfigError: If the environment is none of gctd3's.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any]) -> None:
        super().__init__(env)
        graph = getattr(env.unwrapped, "graph", None)
        if not isinstance(graph, KinematicGraph):
            raise ConfigError(
                f"VectorNodeObservation takes gctd3's vector environments, got {type(env.unwrapped).__name__}; "
                "wrap the robots of others by gymnasium.make_vec(..., wrappers=[NodeObservation])."
            )
        self.graph = graph
        self.single_observation_space = node_space(graph, env.single_observation_space)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)

    def observations(self, observations: Any) -> dict[str, np.ndarray]:  # noqa: ANN401 - Gymnasium's
        """Return the observation of each node, ``[num_envs, F * history]``."""
        return by_node(self.graph, observations, self.num_envs)


def node_space(graph: KinematicGraph, space: gymnasium.Space[Any]) -> Dict:
    """Return the space of each node's observation, from that of all nodes' side by side.

    Raises:
        ConfigError: If the latter is not a box with as many numbers for every node.
    """
    size = int(np.prod(space.shape)) if isinstance(space, Box) else 0
    if not size or size % graph.num_nodes:
        raise ConfigError(f"The observation of {graph.num_nodes} nodes must have a row for each, got {space}.")
    return Dict({name: node_box(size // graph.num_nodes) for name in graph.nodes})


def by_node(graph: KinematicGraph, nodes: np.ndarray, *batch: int) -> dict[str, np.ndarray]:
    """Return a copy of each node's row ``[*batch, F]`` of ``nodes``, whose size is that of ``[*batch, N, F]``."""
    rows = nodes.reshape(*batch, graph.num_nodes, -1)
    return {name: rows[..., row, :].copy() for row, name in enumerate(graph.nodes)}
