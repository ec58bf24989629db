"""TD3's loss (Fujimoto et al. 2018, arXiv:1802.09477), over TorchRL's."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs.utils import step_mdp
from torchrl.objectives import TD3Loss as TorchRLTD3Loss
from torchrl.objectives.utils import distance_loss

from gctd3.compat import priority_weight, reduce_loss, vmapped_critics
from gctd3.nn.stacking import obstacles
from gctd3.objectives.stacked import StackedLoss, output, values

LossAndMetrics = tuple[Tensor, dict[str, Tensor]]


class TD3Loss(StackedLoss, TorchRLTD3Loss):
    """Compute :class:`torchrl.objectives.TD3Loss` faster, and with critics that may read more than the actor does.

    Constructor, keys, losses and gradients are the same, for any networks and any batch size that TorchRL's takes, with
    two differences: critics whose layers can be stacked (:mod:`gctd3.nn.stacking`) run as one batched module (no
    ``vmap``; the actor's loss evaluates the one critic that it uses, so that ``state_action_value_actor`` is ``[*]``
    instead of ``[E, *]``), and the critics' ``in_keys`` are taken from the whole batch, where TorchRL passes on only
    the actor's inputs.

    TorchRL sets exploration type and recurrent mode around every method that ends in ``loss``. :meth:`of_actor` and
    :meth:`of_critics` give the same losses without setting them, for networks of gctd3's layers, which know neither.

    Args:
        actor_network: The deterministic actor.
        qvalue_network: A list of critics, or one, of which TorchRL makes several and draws their parameters anew.
        *args: As TorchRL's.
        **kwargs: As TorchRL's.
    """

    def __init__(
        self,
        actor_network: TensorDictModuleBase,
        qvalue_network: TensorDictModuleBase | Sequence[TensorDictModuleBase],
        *args: Any,  # noqa: ANN401 - TorchRL's
        **kwargs: Any,  # noqa: ANN401 - TorchRL's
    ) -> None:
        super().__init__(actor_network, qvalue_network, *args, **kwargs)
        self.decide(qvalue_network, actor_network)
        # A copy of an unknown actor might differ from it: it may be set to train or evaluate, or hold a state.
        self._known_actor = not obstacles(actor_network)

    def actor_loss(self, tensordict: TensorDictBase) -> LossAndMetrics:
        """Return TorchRL's actor loss of a batch of size ``[*]``, and further values that were computed."""
        return self._of_actor(tensordict)

    def value_loss(self, tensordict: TensorDictBase) -> LossAndMetrics:
        """Return TorchRL's critic loss of a batch of size ``[*]``, and further values that were computed."""
        return self._of_critics(tensordict)

    def of_actor(self, tensordict: TensorDictBase) -> LossAndMetrics:
        """Return the actor's loss: minus the first critic's value of its action (equation below 11 of the paper)."""
        fast = self.stacked and self._known_actor
        return self._of_actor(tensordict) if fast else self.actor_loss(tensordict)

    def of_critics(self, tensordict: TensorDictBase) -> LossAndMetrics:
        """Return the critics' loss: both critics' distance from the target of equation 9."""
        fast = self.stacked and self._known_actor
        return self._of_critics(tensordict) if fast else self.value_loss(tensordict)

    def _of_actor(self, tensordict: TensorDictBase) -> LossAndMetrics:
        action, seen = self._act("actor", tensordict, lambda: self.actor_network_params)
        if self.stacked:
            critic = self._copies.get("first critic", self.qvalue_network, lambda: self.qvalue_network_params.data[0])
            value = action_values = values(critic, seen, {self.tensor_keys.action: action})
        else:
            action_values = self._values("detached critics", seen, lambda: self.qvalue_network_params.data, action)
            value = action_values[0]
        weights = priority_weight(self, tensordict)
        loss = reduce_loss(self, -value, tensordict, weights)
        return loss, {"state_action_value_actor": action_values.detach()}

    def _of_critics(self, tensordict: TensorDictBase) -> LossAndMetrics:
        taken, following = tensordict.get(self.tensor_keys.action), self._following(tensordict)
        noise = (torch.randn_like(taken) * self.policy_noise).clamp(-self.noise_clip, self.noise_clip)
        with torch.no_grad():
            action, seen = self._act("target actor", following, lambda: self.target_actor_network_params)
            action = (action + noise).clamp(self.min_action, self.max_action)
            next_values = self._values("target critics", seen, lambda: self.target_qvalue_network_params, action)
            next_value = next_values.min(0)[0]
            target = self.value_estimator.value_estimate(tensordict, next_value=next_value.unsqueeze(-1)).squeeze(-1)

        value = self._values("critics", tensordict, lambda: self.qvalue_network_params)
        loss = distance_loss(value, target.expand_as(value), loss_function=self.loss_function).sum(0)
        loss = reduce_loss(self, loss, tensordict, priority_weight(self, tensordict))
        return loss, {
            "td_error": (value.detach() - target).pow(2),
            "next_state_value": next_value,
            "pred_value": value.detach(),
            "target_value": target,
        }

    def _following(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return the state after each transition; keys that do not change with it may stand beside ``"next"`` only."""
        following = tensordict.get("next")
        if self.stacked and self._known_actor:
            needed = {*self.actor_network.in_keys, *self.qvalue_network.in_keys} - {self.tensor_keys.action}
            if all(following.get(key, None) is not None for key in needed):
                return following
        return step_mdp(tensordict)

    def _act(
        self, name: str, inputs: TensorDictBase, params: Callable[[], TensorDictBase]
    ) -> tuple[Tensor, TensorDictBase]:
        """Return the actions in ``inputs``, and the critics' inputs there, with all else that the actor wrote."""
        actor, action = self.actor_network, self.tensor_keys.action
        if self.stacked and self._known_actor:
            return output(self._copies.get(name, actor, params), inputs, action), inputs
        with params().to_module(actor, preserve_module_state=False):
            acted = actor(inputs.select(*actor.in_keys, strict=False))
        return acted.get(action), inputs.select(*self.qvalue_network.in_keys, strict=False).update(acted)

    def _values(
        self, name: str, inputs: TensorDictBase, params: Callable[[], TensorDictBase], action: Tensor | None = None
    ) -> Tensor:
        """Return all critics' values ``[E, *]``, of ``action`` or of that in ``inputs``."""
        critics, key = self.qvalue_network, self.tensor_keys.action
        replaced = {} if action is None else {key: action}
        if self.stacked:
            return values(self._copies.get(name, critics, params), inputs, replaced)
        seen = inputs.select(*critics.in_keys, strict=False).update(replaced)
        action_values = vmapped_critics(self, seen.expand(self.num_qvalue_nets, *seen.batch_size), params())
        return action_values.get(self.tensor_keys.state_action_value).squeeze(-1)
