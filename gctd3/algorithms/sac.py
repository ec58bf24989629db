"""SAC with a learned temperature (Haarnoja et al. 2018, arXiv:1812.05905)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from tensordict import TensorDictBase

from gctd3.algorithms.base import Algorithm, Architecture, Metrics, minimize
from gctd3.objectives import FusedSoftUpdate, SACLoss

if TYPE_CHECKING:
    from gctd3.algorithms.settings import SACSettings


class SAC(Algorithm):
    """Train twin critics, a Gaussian actor, and a temperature; the target entropy is minus the number of actions."""

    LOSSES = ("qvalue_v2_loss", "actor_loss")

    def __init__(self, settings: SACSettings, architecture: Architecture) -> None:
        super().__init__(settings.compile)
        self.settings = settings
        self.actor = architecture.stochastic_actor(settings.scale)
        self.loss = SACLoss(
            self.actor,
            [architecture.critic() for _ in range(2)],
            loss_function="l2",
            alpha_init=settings.alpha,
            target_entropy=-float(architecture.action_dim),
        )
        self.loss.make_value_estimator(gamma=settings.gamma)
        self.targets = FusedSoftUpdate(self.loss, tau=settings.tau)
        self.critic_optimizer = self.optimizer("critic", self.loss.qvalue_network_params.values(True, True))
        self.actor_optimizer = self.optimizer("actor", self.loss.actor_network_params.values(True, True))
        self.alpha_optimizer = self.optimizer("alpha", [self.loss.log_alpha])
        # SAC has no target actor; this average serves evaluation only.
        self._average = self.loss.actor_network_params.data.clone()

    def _update(self, batch: TensorDictBase) -> Metrics:
        """Update the critics, the actor, the temperature and the targets, in this order (Algorithm 1)."""
        # Critics: half the squared distance from the target (equation 5).
        alpha = self.loss.log_alpha.detach().exp()
        loss_critic = 0.5 * self.loss.qvalue_v2_loss(batch)[0]
        minimize(self.critic_optimizer, loss_critic)

        # Actor: towards a higher value and a higher entropy (equation 7).
        loss_actor, details = self.loss.actor_loss(batch)
        if not self.critics_alone:
            minimize(self.actor_optimizer, self.imitating(loss_actor, batch))

        # Temperature: up where the entropy of these actions is too low (equation 18).
        minimize(self.alpha_optimizer, self.loss.alpha_loss(details["log_prob"]).mean())

        self.targets.step()
        self._average.lerp_(self.loss.actor_network_params.data, self.settings.tau)
        return {
            "loss_critic": loss_critic.detach(),
            "loss_actor": loss_actor.detach(),
            "alpha": alpha,
            "entropy": -details["log_prob"].mean(),
        }

    def averaged_actor_params(self) -> TensorDictBase:
        """Return the Polyak average of the actor's parameters."""
        return self._average

    def state_dict(self) -> dict[str, object]:
        """Return the state of all parameters, targets, averages, optimisers and counts."""
        average = {str(i): value for i, value in enumerate(self._average.values(True, True))}
        return {**super().state_dict(), "average": average}

    def load_state_dict(self, state: dict[str, object]) -> None:
        """Restore the state that :meth:`state_dict` returned."""
        super().load_state_dict(state)
        average: dict[str, torch.Tensor] = state["average"]  # type: ignore[assignment]
        for i, value in enumerate(self._average.values(True, True)):
            value.copy_(average[str(i)])
