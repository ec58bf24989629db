"""Environments of single robots, stepped one after another."""

from __future__ import annotations

import torch
from torchrl.envs import SerialEnv


class SerialRobots(SerialEnv):
    """:class:`torchrl.envs.SerialEnv`, whose end leaves PyTorch's number of threads as it is.

    TorchRL raises it then, even when an environment that was forgotten is collected in the middle of another training,
    whose sums would differ from there on in their last bits.
    """

    def close(self, *, raise_if_closed: bool = True) -> None:
        """End all of them."""
        threads = torch.get_num_threads()
        super().close(raise_if_closed=raise_if_closed)
        torch.set_num_threads(threads)
