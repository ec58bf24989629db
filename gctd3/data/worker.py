"""The job and the interface of a collecting worker, wherever it runs."""

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
    """Wrap an explorer so that only the actor's weights are synchronised; noise and gaits are its own."""

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
    """Describe the job of one worker.

    Attributes:
        share: Robots of the worker.
        seed: Seed of its robots' starts and of all that its explorer draws.
        cpus: Threads that it may use.
        steps: Control steps of every robot in one of its batches.
        recipe: Recipe of its environment.
        policy: Policy that acts.
    """

    share: slice
    seed: int
    cpus: int
    steps: int
    recipe: EnvRecipe
    policy: Policy

    @property
    def robots(self) -> int:
        """Return the number of the worker's robots."""
        return int(self.share.stop - self.share.start)

    @property
    def frames(self) -> int:
        """Return the number of frames in one of the worker's batches."""
        return self.robots * self.steps

    @property
    def make_env(self) -> Callable[[], EnvBase]:
        """Return a function that makes the worker's environment, to be called where the worker runs."""
        return partial(_make_env, self.recipe, self.robots, self.seed, self.cpus)


def _make_env(recipe: EnvRecipe, robots: int, seed: int, cpus: int) -> EnvBase:
    torch.manual_seed(seed)
    return recipe.share(robots, cpus).make(seed)


class Worker(ABC):
    """Represent a remote collector. Its methods block; :meth:`kill` ends them from another thread."""

    @abstractmethod
    def next(self, weights: TensorDictBase) -> TensorDictBase:
        """Return the next batch, ``[robots, steps]``, collected with these weights."""

    @abstractmethod
    def kill(self) -> None:
        """End the worker at once."""

    @abstractmethod
    def close(self) -> None:
        """Let the worker end."""


Launch = Callable[[Job], Worker]
