"""SAC's loss (Haarnoja et al. 2018, arXiv:1812.05905), over TorchRL's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.objectives import SACLoss as TorchRLSACLoss

from gctd3.compat import replace_sac_critics
from gctd3.objectives.stacked import StackedLoss, values


class SACLoss(StackedLoss, TorchRLSACLoss):
    """Compute :class:`torchrl.objectives.SACLoss` with the critics' stacked parameters run as one batched module.

    Constructor, keys, losses and gradients are the same, for any networks and any batch size that TorchRL's takes.
    Critics whose layers cannot be stacked (:mod:`gctd3.nn.stacking`) are evaluated as TorchRL does; so is, in version 1
    of the algorithm (with a value network), each critic on its share of the batch.

    Args:
        actor_network: The stochastic actor.
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
        self.vmaps_made()

    def vmaps_made(self) -> None:
        """Replace the ``vmap`` that evaluates all critics on the whole batch."""
        if self.stacked:
            replace_sac_critics(self, self._critics)

    def _critics(self, inputs: TensorDictBase, params: TensorDictBase) -> TensorDictBase:
        """Return the critics' values ``[E, *, 1]`` of ``inputs`` of batch size ``[*]``."""
        if params is self.qvalue_network_params:
            name = "critics"
        elif params is self.target_qvalue_network_params:
            name = "target critics"
        else:
            name, params = "detached critics", self.qvalue_network_params.data
        critics = self._copies.get(name, self.qvalue_network, lambda: params)
        value = values(critics, inputs).unsqueeze(-1)
        return TensorDict({self.tensor_keys.state_action_value: value}, value.shape[:-1])
