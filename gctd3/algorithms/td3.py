"""TD3 (Fujimoto et al. 2018, arXiv:1802.09477). With ``network=gcn`` it is GCTD3 (Phan Bui et al. 2022)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tensordict import TensorDictBase

from gctd3.algorithms.base import Algorithm, Architecture, Metrics, minimize
from gctd3.objectives import FusedSoftUpdate, TD3Loss

if TYPE_CHECKING:
    from gctd3.algorithms.settings import TD3Settings


class TD3(Algorithm):
    """Train twin critics with noise on the targets' actions, and an actor with delayed updates."""

    LOSSES = ("of_critics", "of_actor")

    def __init__(self, settings: TD3Settings, architecture: Architecture) -> None:
        super().__init__(settings.compile)
        self.settings: TD3Settings = settings
        self.actor = architecture.actor()
        # A list, because a single module would be copied and initialised anew.
        critics = [architecture.critic() for _ in range(2)]
        self.loss = TD3Loss(
            self.actor,
            critics,
            bounds=(-1.0, 1.0),
            policy_noise=settings.policy_noise,
            noise_clip=settings.noise_clip,
            loss_function="l2",
        )
        self.loss.make_value_estimator(gamma=settings.gamma)
        self.targets = FusedSoftUpdate(self.loss, tau=settings.tau)
        self.critic_optimizer = self.optimizer("critic", self.loss.qvalue_network_params.values(True, True))
        self.actor_optimizer = self.optimizer("actor", self.loss.actor_network_params.values(True, True))

    def _update(self, batch: TensorDictBase) -> Metrics:
        """Update the critics and, at every ``policy_delay``-th update, the actor and the targets."""
        # Critics: towards the smaller target critic's value of the target actor's noisy action (equations 9 to 11).
        loss_critic, details = self.loss.of_critics(batch)
        minimize(self.critic_optimizer, loss_critic)
        metrics = {"loss_critic": loss_critic.detach(), "value": details["pred_value"].mean()}

        if self.updates % self.settings.policy_delay == 0:
            if not self.critics_alone:
                # Actor: up the first critic's value.
                loss_actor, _ = self.loss.of_actor(batch)
                minimize(self.actor_optimizer, self.imitating(loss_actor, batch))
                metrics["loss_actor"] = loss_actor.detach()

            # Targets: Polyak averages (equations 12 and 13).
            self.targets.step()
        return metrics

    def averaged_actor_params(self) -> TensorDictBase:
        """Return the parameters of the target actor."""
        return self.loss.target_actor_network_params
