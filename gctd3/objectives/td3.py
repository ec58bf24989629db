"""TD3's loss (Fujimoto et al. 2018, arXiv:1802.09477), over TorchRL's."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.objectives import TD3Loss as TorchRLTD3Loss
from torchrl.objectives.utils import distance_loss

from gctd3.objectives.stacked import stacked_values


class TD3Loss(TorchRLTD3Loss):
    """:class:`torchrl.objectives.TD3Loss`, faster, and with critics that may read more than the actor does.

    Same constructor and keys, same losses and gradients. Two differences: the critics' stacked parameters run as one
    batched module (no ``vmap``; the actor's loss evaluates the one critic that it uses), and the critics' ``in_keys``
    are taken from the whole batch, where TorchRL passes on only what the actor reads.
    """

    def _set_in_keys(self) -> None:
        super()._set_in_keys()
        following = [("next", key) for key in self.qvalue_network.in_keys if key != self.tensor_keys.action]
        self._in_keys: list[object] = list({*self._in_keys, *following})

    def _act(self, params: TensorDictBase, inputs: TensorDictBase) -> TensorDictBase:
        """``inputs`` (copied) with the actor's action in it."""
        with params.to_module(self.actor_network, preserve_module_state=False):
            return self.actor_network(inputs.copy())

    def actor_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Minus the first critic's value of the actor's action (equation below 11 of the paper)."""
        acted = self._act(self.actor_network_params, tensordict)
        value = stacked_values(self.qvalue_network, self._cached_detach_qvalue_network_params[0], acted)
        loss = self._reduce_loss(-value, tensordict=tensordict, weights=self._maybe_get_priority_weight(tensordict))
        return loss, {"state_action_value_actor": value.detach()}

    def value_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Both critics' distance from the target of equation 9."""
        action = tensordict.get(self.tensor_keys.action)
        noise = (torch.randn_like(action) * self.policy_noise).clamp(-self.noise_clip, self.noise_clip)
        with torch.no_grad():
            following = self._act(self.target_actor_network_params, tensordict.get("next"))
            next_action = (following.get(self.tensor_keys.action) + noise).clamp(self.min_action, self.max_action)
            following.set(self.tensor_keys.action, next_action)
            next_value = stacked_values(self.qvalue_network, self.target_qvalue_network_params, following).min(0)[0]
            following.set(self.tensor_keys.state_action_value, next_value.unsqueeze(-1))
            target = self.value_estimator.value_estimate(tensordict.copy().set("next", following)).squeeze(-1)

        values = stacked_values(self.qvalue_network, self.qvalue_network_params, tensordict)
        loss = distance_loss(values, target.expand_as(values), loss_function=self.loss_function).sum(0)
        loss = self._reduce_loss(loss, tensordict=tensordict, weights=self._maybe_get_priority_weight(tensordict))
        return loss, {
            "td_error": (values.detach() - target).pow(2),
            "next_state_value": next_value,
            "pred_value": values.detach(),
            "target_value": target,
        }
