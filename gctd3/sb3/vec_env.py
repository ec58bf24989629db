"""Robots that MuJoCo steps all at once, as an environment of Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn

from gctd3.envs.node_observation import VectorNodeObservation
from gctd3.errors import ConfigError


class BatchedVecEnv(VecEnv):
    """Step N robots of one of gctd3's tasks at once, each node observed under its name.

    Stable-Baselines3's own ``DummyVecEnv`` steps environments one after another; here one call of MuJoCo steps all. A
    robot whose episode ended starts the next one at once, and its info has ``terminal_observation`` and
    ``TimeLimit.truncated``, as Stable-Baselines3 expects. Put a ``VecMonitor`` around it for returns of episodes.

    Args:
        name: Gymnasium's id of the task, or a Gymnasium vector environment with ``autoreset_mode=DISABLED``.
        num_envs: Number of robots, for an id.
        **settings: Further arguments of the task's vector environment, for an id; see :class:`.BipedVectorEnv`.

    Attributes:
        graph: The robots' graph, for an id.

    Raises:
        ConfigError: If the environment resets robots by itself.
    """

    def __init__(self, name: str | VectorEnv[Any, Any, Any], num_envs: int = 64, **settings: Any) -> None:  # noqa: ANN401
        if isinstance(name, str):
            made = gymnasium.make_vec(name, num_envs=num_envs, autoreset_mode=AutoresetMode.DISABLED, **settings)
            nodes = VectorNodeObservation(made)
            self.env, self.graph = cast("VectorEnv[Any, Any, Any]", nodes), nodes.graph
        else:
            self.env = name
        if (mode := self.env.metadata.get("autoreset_mode")) is not AutoresetMode.DISABLED:
            raise ConfigError(f"The environment's autoreset_mode must be DISABLED, got {mode}.")
        self._actions = np.zeros(0)
        self._starts: list[int | None] = [None] * self.env.num_envs
        super().__init__(self.env.num_envs, self.env.single_observation_space, self.env.single_action_space)

    def reset(self) -> VecEnvObs:
        """Start an episode on every robot."""
        seeds: Any = None if None in self._starts else self._starts
        observation, infos = self.env.reset(seed=seeds)
        self.reset_infos = rows(infos, self.num_envs)
        self.seed()
        return cast(VecEnvObs, observation)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Keep the first robot's seed for the next reset, each further one's being one more; ``None`` for no seed."""
        self._starts = [None if seed is None else seed + i for i in range(self.num_envs)]
        return self._starts

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions ``[num_envs, A]`` for :meth:`step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Take one control step of every robot, and reset those whose episode ended."""
        observation, reward, terminated, truncated, infos = self.env.step(self._actions)
        ended = terminated | truncated
        listed = rows(infos, self.num_envs)
        if ended.any():
            last = observation
            observation, _ = self.env.reset(options={"reset_mask": ended.copy()})
            for i in np.flatnonzero(ended).tolist():
                listed[i]["terminal_observation"] = row(last, i)
                listed[i]["TimeLimit.truncated"] = bool(truncated[i] and not terminated[i])
        return cast(VecEnvObs, observation), np.asarray(reward, dtype=np.float32), ended, listed

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute, which all robots share, once for each of ``indices``."""
        owner: Any = self.env
        # Gymnasium's wrappers of vector environments do not hand attributes on.
        while not hasattr(owner, attr_name) and isinstance(owner, VectorWrapper):
            owner = owner.env
        return [getattr(owner, attr_name)] * self._count(indices)

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:  # noqa: ANN401
        """Set an attribute of all robots.

        Raises:
            ConfigError: If ``indices`` are some robots only, which share it.
        """
        if self._count(indices) != self.num_envs:
            raise ConfigError(f"{attr_name} can only be set for all robots: they share one environment.")
        setattr(self.env.unwrapped, attr_name, value)

    def env_method(
        self,
        method_name: str,
        *method_args: Any,  # noqa: ANN401
        indices: VecEnvIndices = None,
        **method_kwargs: Any,  # noqa: ANN401
    ) -> list[Any]:
        """Refuse to call a method of one robot's environment, since there is none.

        Raises:
            ConfigError: Always.
        """
        raise ConfigError(f"{method_name} cannot be called for a robot by itself: all robots share one environment.")

    def env_is_wrapped(self, wrapper_class: type[Any], indices: VecEnvIndices = None) -> list[bool]:
        """Tell that no robot has an environment of its own that a wrapper could be around."""
        return [False] * self._count(indices)

    def _count(self, indices: VecEnvIndices) -> int:
        if indices is None:
            return self.num_envs
        return 1 if isinstance(indices, int) else len(list(indices))


def rows(infos: Mapping[str, Any], count: int) -> list[dict[str, Any]]:
    """Return each environment's info from Gymnasium's of all: arrays, each with a mask ``_name`` of who has it."""
    listed: list[dict[str, Any]] = [{} for _ in range(count)]
    for name, values in infos.items():
        if name.startswith("_") and name[1:] in infos:
            continue
        nested: Sequence[Any] = rows(values, count) if isinstance(values, Mapping) else values
        has = infos.get(f"_{name}", np.ones(count, dtype=bool))
        for i in np.flatnonzero(has).tolist():
            listed[i][name] = nested[i]
    return listed


def row(observation: Any, index: int) -> Any:  # noqa: ANN401 - an array, or a mapping of arrays
    """Return one environment's observation from all environments'."""
    if isinstance(observation, Mapping):
        return {name: values[index] for name, values in observation.items()}
    return observation[index]
