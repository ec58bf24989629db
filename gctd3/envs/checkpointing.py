"""The whole state of an environment, to be set again later: simulator, task memory, history stacks, random state."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from torch.nn.parameter import UninitializedBuffer
from torchrl.envs import EnvBase, SerialEnv, TransformedEnv

from gctd3.envs.batched import BatchedEnv
from gctd3.envs.library_robots import LibraryRobots
from gctd3.envs.mujoco_state import load_task_state, task_state
from gctd3.envs.nodes import simulator


def env_state(env: EnvBase) -> dict[str, Any]:
    """State of an environment of :func:`gctd3.envs.factory.build_env`; tensors are copies.

    Raises:
        TypeError: If it is another one.
    """
    if isinstance(env, TransformedEnv):
        buffers = {
            name: buffer.clone()
            for name, buffer in env.transform.named_buffers()
            if not isinstance(buffer, UninitializedBuffer)
        }
        return {"base": env_state(env.base_env), "buffers": buffers}
    if isinstance(env, BatchedEnv):
        return env.simulation.state_dict()
    state: dict[str, Any] = {"robots": [_robot_state(wrapper) for wrapper in _robots(env)]}
    if isinstance(env, LibraryRobots):
        state["seen"] = {key: np.array(values) for key, values in env.seen.items()}
    return state


def load_env_state(env: EnvBase, state: dict[str, Any]) -> None:
    """Set what :func:`env_state` gave; ``env`` must have been reset at least once."""
    if isinstance(env, TransformedEnv):
        load_env_state(env.base_env, state["base"])
        buffers = dict(env.transform.named_buffers())
        for name, value in state["buffers"].items():
            buffers[name].copy_(value)
    elif isinstance(env, BatchedEnv):
        env.simulation.load_state_dict(state)
    else:
        for wrapper, one in zip(_robots(env), state["robots"], strict=True):
            _load_robot_state(wrapper, one)
        if isinstance(env, LibraryRobots):
            env.seen = {key: np.array(values) for key, values in state["seen"].items()}


def _robot_state(wrapper: EnvBase) -> dict[str, Any]:
    inner = wrapper._env
    return inner.state_dict() if hasattr(inner, "state_dict") else task_state(inner, *simulator(wrapper))


def _load_robot_state(wrapper: EnvBase, state: dict[str, Any]) -> None:
    inner = wrapper._env
    if hasattr(inner, "load_state_dict"):
        inner.load_state_dict(state)
    else:
        load_task_state(inner, *simulator(wrapper), state)


def _robots(env: EnvBase) -> Iterator[EnvBase]:
    """The environments of single robots, without their transforms, of which none has a state."""
    if isinstance(env, LibraryRobots):
        yield from env.robots
        return
    if not isinstance(env, SerialEnv):
        raise TypeError(f"The state of a {type(env).__name__} cannot be read; expected one of build_env.")
    for one in env._envs:
        yield one.base_env if isinstance(one, TransformedEnv) else one
