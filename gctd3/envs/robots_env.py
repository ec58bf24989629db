"""What every environment of N robots at once has: its specs, its ends, who is to be reset, and what is seen of it."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase


@dataclass(frozen=True)
class Glance:
    """What is seen of robots beside what their policies observe, for who judges them.

    Attributes:
        height: Body height from standing, shape ``[N]`` (m).
        hips: Angles of the hips, one a leg, in the sense of their mirror images, shape ``[N, feet]`` (rad).
        feet_down: Whether each foot touches the ground, shape ``[N, feet]``.
    """

    height: np.ndarray
    hips: np.ndarray
    feet_down: np.ndarray


class RobotsEnv(EnvBase):
    """N robots as one TorchRL environment of batch size ``[N]``.

    Writes, with leading dimension ``[N]``: ``nodes``, ``counters``, ``position [1]`` (m), ``success [1]``,
    ``diverged [1]``, TorchRL's reward and done keys, and what :class:`torchrl.envs.InitTracker` and
    :class:`torchrl.envs.StepCounter` would: ``is_init [1]``, ``step_count [1]``. Actions: ``[A]`` in [-1, 1].

    Args:
        robots: ``N``.
        nodes: Shape of a robot's nodes.
        counters: Numbers in its counters.
        actions: ``A``.
    """

    def __init__(self, robots: int, nodes: tuple[int, int], counters: int, actions: int) -> None:
        n = robots
        super().__init__(batch_size=torch.Size([n]))
        flag = Binary(1, shape=(n, 1), dtype=torch.bool)
        self.observation_spec = Composite(
            nodes=Unbounded((n, *nodes)),
            counters=Unbounded((n, counters)),
            position=Unbounded((n, 1)),
            success=flag.clone(),
            diverged=flag.clone(),
            is_init=flag.clone(),
            step_count=Bounded(low=0, high=torch.iinfo(torch.int64).max, shape=(n, 1), dtype=torch.int64),
            shape=(n,),
        )
        self.action_spec = Bounded(low=-1.0, high=1.0, shape=(n, actions))
        self.reward_spec = Unbounded((n, 1))
        self.done_spec = Composite(done=flag, terminated=flag.clone(), truncated=flag.clone(), shape=(n,))

    @abstractmethod
    def glance(self) -> Glance:
        """Look at the robots as they are now."""

    @abstractmethod
    def checkpoint(self) -> dict[str, Any]:
        """Return everything that the next steps depend on, but the actions; arrays are copies."""

    @abstractmethod
    def restore(self, state: dict[str, Any]) -> None:
        """Set what :meth:`checkpoint` gave."""

    def chosen(self, tensordict: TensorDictBase | None) -> np.ndarray:
        """The robots that a reset is for, bool ``[N]``: all, if it does not say."""
        (n,) = self.batch_size
        mask = None if tensordict is None else tensordict.get("_reset", None)
        return np.ones(n, dtype=bool) if mask is None else mask.reshape(n).cpu().numpy()


def column(values: np.ndarray) -> torch.Tensor:
    """One number of each robot, ``[N]``, as ``[N, 1]``."""
    # NumPy's is several times quicker than PyTorch's. By indexing the stride would be 0, on which torch.stack dies.
    return torch.from_numpy(values.reshape(-1, 1))


def ends(terminated: np.ndarray, truncated: np.ndarray) -> dict[str, torch.Tensor]:
    """TorchRL's done keys, from bool ``[N]``."""
    return {
        "done": column(terminated | truncated),
        "terminated": column(terminated),
        "truncated": column(truncated),
    }
