"""DDPG (Lillicrap et al. 2016, arXiv:1509.02971)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tensordict import TensorDictBase
from torchrl.objectives import DDPGLoss

from gctd3.algorithms.base import Algorithm, Architecture, Metrics, minimize
from gctd3.objectives import FusedSoftUpdate

if TYPE_CHECKING:
    from gctd3.algorithms.settings import DDPGSettings


class DDPG(Algorithm):
    """Train one critic, and an actor that follows the gradient of its value."""

    LOSSES = ("loss_value", "loss_actor")

    def __init__(self, settings: DDPGSettings, architecture: Architecture) -> None:
        super().__init__(settings.compile)
        self.settings = settings
        self.actor = architecture.actor()
        self.loss = DDPGLoss(self.actor, architecture.critic(), loss_function="l2", delay_actor=True, delay_value=True)
        self.loss.make_value_estimator(gamma=settings.gamma)
        self.targets = FusedSoftUpdate(self.loss, tau=settings.tau)
        self.critic_optimizer = self.optimizer("critic", self.loss.value_network_params.values(True, True))
        self.actor_optimizer = self.optimizer("actor", self.loss.actor_network_params.values(True, True))

    def _update(self, batch: TensorDictBase) -> Metrics:
        """Update the critic, the actor and the targets."""
        loss_critic, details = self.loss.loss_value(batch)
        minimize(self.critic_optimizer, loss_critic)
        metrics = {"loss_critic": loss_critic.detach()}
        if not self.critics_alone:
            loss_actor, _ = self.loss.loss_actor(batch)
            minimize(self.actor_optimizer, self.imitating(loss_actor, batch))
            metrics["loss_actor"] = loss_actor.detach()
        self.targets.step()
        return {**metrics, "value": details["pred_value"].detach().mean()}

    def averaged_actor_params(self) -> TensorDictBase:
        """Return the parameters of the target actor."""
        return self.loss.target_actor_network_params
