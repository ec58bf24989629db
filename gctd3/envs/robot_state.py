"""The state of one robot's environment of dm_control or Gymnasium, as TorchRL wraps it."""

from __future__ import annotations

from typing import Any

from torchrl.envs import EnvBase

from gctd3.compat import wrapped_env
from gctd3.envs.mujoco_state import load_task_state, task_state
from gctd3.envs.nodes import simulator


def robot_state(wrapper: EnvBase) -> dict[str, Any]:
    """Return everything that the next steps depend on, except the actions."""
    inner = wrapped_env(wrapper)
    return inner.state_dict() if hasattr(inner, "state_dict") else task_state(inner, *simulator(wrapper))


def load_robot_state(wrapper: EnvBase, state: dict[str, Any]) -> None:
    """Restore the state returned by :func:`robot_state`."""
    inner = wrapped_env(wrapper)
    if hasattr(inner, "load_state_dict"):
        inner.load_state_dict(state)
    else:
        load_task_state(inner, *simulator(wrapper), state)
