"""The whole state of an environment, to be set again later: simulator, task memory, history stacks, random state."""

from __future__ import annotations

from typing import Any

from torch.nn.parameter import UninitializedBuffer
from torchrl.envs import EnvBase, TransformedEnv


def env_state(env: EnvBase) -> dict[str, Any]:
    """Return the state of an environment of :func:`gctd3.envs.factory.build_env`; tensors are copies.

    Raises:
        TypeError: If it is another environment.
    """
    if isinstance(env, TransformedEnv):
        buffers = {
            name: buffer.clone()
            for name, buffer in env.transform.named_buffers()
            if not isinstance(buffer, UninitializedBuffer)
        }
        return {"base": env_state(env.base_env), "buffers": buffers}
    if "checkpoint" not in dir(type(env)):
        raise TypeError(f"The state of a {type(env).__name__} cannot be read; expected one of build_env.")
    state: dict[str, Any] = env.checkpoint()
    return state


def load_env_state(env: EnvBase, state: dict[str, Any]) -> None:
    """Restore the state returned by :func:`env_state`; ``env`` must have been reset at least once."""
    if isinstance(env, TransformedEnv):
        load_env_state(env.base_env, state["base"])
        buffers = dict(env.transform.named_buffers())
        for name, value in state["buffers"].items():
            buffers[name].copy_(value)
    else:
        env.restore(state)
