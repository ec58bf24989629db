"""Environments of single robots, stepped one after another."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from torchrl.envs import EnvBase, SerialEnv, TransformedEnv

from gctd3.compat import serial_envs
from gctd3.envs.robot_state import load_robot_state, robot_state


class SerialRobots(SerialEnv):
    """Provide a :class:`torchrl.envs.SerialEnv` that leaves PyTorch's number of threads as it is when it closes.

    TorchRL raises this number on closing, even when a forgotten environment is garbage-collected in the middle of
    another training, whose sums would differ from there on in their last bits.
    """

    def checkpoint(self) -> dict[str, Any]:
        """Return the state of every robot; their transforms have no state."""
        return {"robots": [robot_state(one) for one in self._robots()]}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore the state returned by :meth:`checkpoint`."""
        for one, robot in zip(self._robots(), state["robots"], strict=True):
            load_robot_state(one, robot)

    def _robots(self) -> Iterator[EnvBase]:
        for one in serial_envs(self):
            yield one.base_env if isinstance(one, TransformedEnv) else one

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Close the environments of all robots."""
        threads = torch.get_num_threads()
        super().close(raise_if_closed=raise_if_closed)
        torch.set_num_threads(threads)
