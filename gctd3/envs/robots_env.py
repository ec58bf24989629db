"""The base of environments of N robots at once: specs, done keys, partial resets and measurements for evaluations."""

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
    """Hold measurements of robots for their evaluation, besides their policies' observations.

    Attributes:
        height: Body height from standing, shape ``[N]`` (m).
        hips: Hip angles, one per leg, with the sign of the first hip of a mirrored pair, shape ``[N, feet]`` (rad).
        feet_down: Whether each foot touches the ground, shape ``[N, feet]``.
        command: Commanded velocity forward, to the left and turning, shape ``[N, 3]`` (m/s, m/s, rad/s); ``None`` for a
            task without it.
        moved: The robot's velocities of the same kind, shape ``[N, 3]``; ``None`` for a task without commands.
        jump: Commanded height of a jump, and its apex so far, shape ``[N, 2]`` (m); ``None`` for a task without jumps.
    """

    height: np.ndarray
    hips: np.ndarray
    feet_down: np.ndarray
    command: np.ndarray | None = None
    moved: np.ndarray | None = None
    jump: np.ndarray | None = None


class RobotsEnv(EnvBase):
    """Represent N robots as one TorchRL environment of batch size ``[N]``.

    Writes, with leading dimension ``[N]``: ``nodes``, ``counters``, ``position [1]`` (m), ``success [1]``,
    ``diverged [1]``, TorchRL's reward and done keys, and what :class:`torchrl.envs.InitTracker` and
    :class:`torchrl.envs.StepCounter` would: ``is_init [1]``, ``step_count [1]``. Actions: ``[A]`` in [-1, 1].

    Args:
        robots: ``N``, the number of robots.
        nodes: Shape of a robot's node features.
        counters: Number of a robot's counters.
        actions: ``A``, the number of a robot's actions.
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

    def lanes(self) -> list[tuple[str, int]] | None:
        """Return the kind and the level of the ground on which each robot's episode began; ``None`` on a plane."""
        return None

    @abstractmethod
    def glance(self) -> Glance:
        """Return the present measurements of the robots."""

    @abstractmethod
    def checkpoint(self) -> dict[str, Any]:
        """Return everything that the next steps depend on, except the actions; arrays are copies."""

    @abstractmethod
    def restore(self, state: dict[str, Any]) -> None:
        """Restore the state returned by :meth:`checkpoint`."""

    def chosen(self, tensordict: TensorDictBase | None) -> np.ndarray:
        """Return the mask of the robots to reset, bool ``[N]``: all of them if ``"_reset"`` is missing."""
        (n,) = self.batch_size
        mask = None if tensordict is None else tensordict.get("_reset", None)
        return np.ones(n, dtype=bool) if mask is None else mask.reshape(n).cpu().numpy()


def column(values: np.ndarray) -> torch.Tensor:
    """Return one number per robot, ``[N]``, as a tensor ``[N, 1]``."""
    # NumPy's reshape is several times faster than PyTorch's. Indexing gives a stride of 0, which breaks torch.stack.
    return torch.from_numpy(values.reshape(-1, 1))


def ends(terminated: np.ndarray, truncated: np.ndarray) -> dict[str, torch.Tensor]:
    """Return TorchRL's done keys, from bool ``[N]``."""
    return {
        "done": column(terminated | truncated),
        "terminated": column(terminated),
        "truncated": column(truncated),
    }
