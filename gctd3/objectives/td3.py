"""TD3's loss (Fujimoto et al. 2018, arXiv:1802.09477), over TorchRL's."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.objectives import TD3Loss as TorchRLTD3Loss
from torchrl.objectives.utils import distance_loss

from gctd3.objectives.stacked import Networks, output, values


class TD3Loss(TorchRLTD3Loss):
    """:class:`torchrl.objectives.TD3Loss`, faster, and with critics that may read more than the actor does.

    Same constructor and keys, same losses and gradients. Two differences: the critics' stacked parameters run as one
    batched module (no ``vmap``; the actor's loss evaluates the one critic that it uses), and the critics' ``in_keys``
    are taken from the whole batch, where TorchRL passes on only what the actor reads.

    TorchRL sets exploration type and recurrent mode around every method that ends in ``loss``. For networks that know
    neither, :meth:`of_actor` and :meth:`of_critics` give the same without.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:  # noqa: ANN401 - TorchRL's
        super().__init__(*args, **kwargs)
        self.__dict__["_networks"] = Networks()

    def _apply(self, *args: Any, **kwargs: Any) -> TD3Loss:  # noqa: ANN401 - PyTorch's
        self._networks.clear()
        return super()._apply(*args, **kwargs)

    def _set_in_keys(self) -> None:
        super()._set_in_keys()
        following = [("next", key) for key in self.qvalue_network.in_keys if key != self.tensor_keys.action]
        self._in_keys: list[object] = list({*self._in_keys, *following})

    def actor_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """As of TorchRL's, from a batch of size ``[B]``: the loss and what else it found."""
        return self.of_actor(tensordict)

    def value_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """As of TorchRL's, from a batch of size ``[B]``: the loss and what else it found."""
        return self.of_critics(tensordict)

    def of_actor(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Minus the first critic's value of the actor's action (equation below 11 of the paper)."""
        networks, key = self._networks, self.tensor_keys.action
        actor = networks.get("actor", self.actor_network, lambda: self.actor_network_params)
        critic = networks.get("first critic", self.qvalue_network, lambda: self.qvalue_network_params.data[0])
        value = values(critic, tensordict, **{key: output(actor, tensordict, key)})
        loss = self._reduce_loss(-value, tensordict=tensordict, weights=self._maybe_get_priority_weight(tensordict))
        return loss, {"state_action_value_actor": value.detach()}

    def of_critics(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Both critics' distance from the target of equation 9."""
        networks, key = self._networks, self.tensor_keys.action
        taken, following = tensordict.get(key), tensordict.get("next")
        noise = (torch.randn_like(taken) * self.policy_noise).clamp(-self.noise_clip, self.noise_clip)
        with torch.no_grad():
            actor = networks.get("target actor", self.actor_network, lambda: self.target_actor_network_params)
            critics = networks.get("target critics", self.qvalue_network, lambda: self.target_qvalue_network_params)
            action = (output(actor, following, key) + noise).clamp(self.min_action, self.max_action)
            next_value = values(critics, following, **{key: action}).min(0)[0]
            target = self.value_estimator.value_estimate(tensordict, next_value=next_value.unsqueeze(-1)).squeeze(-1)

        critics = networks.get("critics", self.qvalue_network, lambda: self.qvalue_network_params)
        value = values(critics, tensordict)
        loss = distance_loss(value, target.expand_as(value), loss_function=self.loss_function).sum(0)
        loss = self._reduce_loss(loss, tensordict=tensordict, weights=self._maybe_get_priority_weight(tensordict))
        return loss, {
            "td_error": (value.detach() - target).pow(2),
            "next_state_value": next_value,
            "pred_value": value.detach(),
            "target_value": target,
        }
