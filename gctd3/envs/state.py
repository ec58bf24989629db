"""The whole state of an environment, to be set again later: simulator, task memory, history stacks, random state."""

from __future__ import annotations

from typing import Any

from torch.nn.parameter import UninitializedBuffer
from torchrl.envs import EnvBase, SerialEnv, TransformedEnv

from gctd3.envs.batched import BatchedEnv


def has_state(env: EnvBase) -> bool:
    """Whether :func:`env_state` can read it: the walking task can be, other libraries' tasks not."""
    inner = env.base_env if isinstance(env, TransformedEnv) else env
    if isinstance(inner, SerialEnv):
        return all(hasattr(wrapper._env, "load_state_dict") for wrapper in inner._envs)
    return isinstance(inner, BatchedEnv)


def env_state(env: EnvBase) -> dict[str, Any]:
    """State of an environment of :func:`gctd3.envs.factory.build_env` on the walking task; tensors are copies.

    Raises:
        TypeError: If its state cannot be read.
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
    return {"robots": [environment.state_dict() for environment in _dm_control(env)]}


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
        for environment, one in zip(_dm_control(env), state["robots"], strict=True):
            environment.load_state_dict(one)


def _dm_control(env: EnvBase) -> list[Any]:
    if not has_state(env):
        raise TypeError(f"The state of a {type(env).__name__} cannot be read; expected the walking task.")
    return [wrapper._env for wrapper in env._envs]
