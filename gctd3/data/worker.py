"""What a worker that collects gets, and what it has to do, wherever it is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from gctd3.data.exploration import Explorer
from gctd3.envs.factory import EnvRecipe


class Policy(TensorDictModuleBase):
    """An explorer of which only the actor's weights are seen, and so synchronised; noise and gaits are its own."""

    def __init__(self, explorer: Explorer) -> None:
        super().__init__()
        self.in_keys, self.out_keys = explorer.in_keys, explorer.out_keys
        self.actor = explorer.actor
        self._explorer = (explorer,)  # a module in a tuple is not registered

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the next action of every robot."""
        return self._explorer[0](tensordict)


@dataclass(frozen=True)
class Job:
    """What one worker has to do.

    Attributes:
        share: Its robots.
        seed: Of its robots' starts and of all that its explorer draws.
        cpus: Threads that it may use.
        steps: Control steps of every robot in one of its batches.
        recipe: Of its environment.
        policy: Acts.
    """

    share: slice
    seed: int
    cpus: int
    steps: int
    recipe: EnvRecipe
    policy: Policy

    @property
    def robots(self) -> int:
        """How many robots it has."""
        return int(self.share.stop - self.share.start)

    @property
    def frames(self) -> int:
        """Frames in one of its batches."""
        return self.robots * self.steps

    @property
    def make_env(self) -> Callable[[], EnvBase]:
        """Makes its environment, where it is."""
        return partial(_make_env, self.recipe, self.robots, self.seed, self.cpus)


def _make_env(recipe: EnvRecipe, robots: int, seed: int, cpus: int) -> EnvBase:
    torch.manual_seed(seed)
    return recipe.share(robots, cpus).make(seed)


class Worker(ABC):
    """A remote collector. Its methods block; :meth:`kill` ends them from another thread."""

    @abstractmethod
    def next(self, weights: TensorDictBase) -> TensorDictBase:
        """Its next batch, ``[robots, steps]``, collected with these weights."""

    @abstractmethod
    def kill(self) -> None:
        """End it at once."""

    @abstractmethod
    def close(self) -> None:
        """Let it end."""


Launch = Callable[[Job], Worker]
