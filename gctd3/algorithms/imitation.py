"""Imitate another controller: first the actor alone, then as a term of its loss that fades.

The term is that of TD3+BC (Fujimoto & Gu 2021, arXiv:2106.06860), on the actions of a controller instead of data's.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torch.nn.functional import mse_loss
from torchrl.envs.utils import ExplorationType, set_exploration_type

from gctd3.algorithms.adam import Adam

if TYPE_CHECKING:
    from gctd3.algorithms.settings import ImitationSettings


class Imitation:
    """Train an actor to act as a controller does.

    Args:
        settings: How long, and how strongly.
        controller: Function from a batch of observations ``[B]`` to the actions ``[B, A]`` that the controller takes
            there.
        sample: Function that draws a batch of observations for which the controller is known; ``None`` if it is for
            all, so that it is imitated on the batches of the updates.
    """

    def __init__(
        self,
        settings: ImitationSettings,
        controller: Callable[[TensorDictBase], Tensor],
        sample: Callable[[], TensorDictBase] | None = None,
    ) -> None:
        self.settings, self.controller, self.sample = settings, controller, sample

    def begin(self, actor: TensorDictModuleBase, sample: Callable[[], TensorDictBase], learning_rate: float) -> float:
        """Train an actor on batches of observations until it acts as the controller.

        Args:
            actor: The actor, whose parameters change.
            sample: Function that draws a batch.
            learning_rate: Learning rate of Adam where the settings have none.

        Returns:
            The mean squared difference of the actions in the last batch.
        """
        falls = self.settings.initial_learning_rate is not None
        rate = self.settings.initial_learning_rate or learning_rate
        optimizer = Adam(actor.parameters(), lr=rate)
        difference = torch.zeros(())
        for update in range(self.settings.updates):
            if falls:
                optimizer.param_groups[0]["lr"] = rate * (1.0 - update / self.settings.updates)
            difference = self.difference(actor, sample())
            optimizer.zero_grad()
            difference.backward()  # type: ignore[no-untyped-call]
            optimizer.step()
        return float(difference.detach())

    def difference(self, actor: TensorDictModuleBase, batch: TensorDictBase) -> Tensor:
        """Return the mean squared difference between the actor's actions and the controller's, a scalar."""
        # The mode of a Gaussian policy.
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            action: Tensor = actor(batch.select(*actor.in_keys)).get("action")
        return mse_loss(action, self.controller(batch).to(action.device))

    def critics_alone(self, updates: int) -> bool:
        """Return whether only the critics learn in the ``updates``-th update."""
        return updates <= self.settings.critics_first

    def weight(self, updates: int) -> float:
        """Return the factor of the term in the ``updates``-th update."""
        return self.settings.weight * max(0.0, 1.0 - updates / self.settings.fade)

    def add_to(self, loss: Tensor, actor: TensorDictModuleBase, batch: TensorDictBase, updates: int) -> Tensor:
        """Return an actor's loss with the term, whose unit is the size of the loss.

        Args:
            loss: The actor's loss of the batch, a scalar.
            actor: The actor.
            batch: The batch.
            updates: Number of this update.
        """
        weight = self.weight(updates)
        if not weight:
            return loss
        seen = batch if self.sample is None else self.sample()
        return loss + weight * loss.detach().abs() * self.difference(actor, seen)
