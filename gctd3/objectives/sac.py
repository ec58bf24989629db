"""SAC's loss (Haarnoja et al. 2018, arXiv:1812.05905), over TorchRL's."""

from __future__ import annotations

from typing import Any

from tensordict import TensorDict, TensorDictBase
from torchrl.objectives import SACLoss as TorchRLSACLoss

from gctd3.objectives.stacked import Networks, values


class SACLoss(TorchRLSACLoss):
    """:class:`torchrl.objectives.SACLoss` with the critics' stacked parameters run as one batched module.

    Same constructor and keys, same losses and gradients; version 2 of the algorithm only (no value network).
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:  # noqa: ANN401 - TorchRL's
        super().__init__(*args, **kwargs)
        self.__dict__["_networks"] = Networks()

    def _apply(self, *args: Any, **kwargs: Any) -> SACLoss:  # noqa: ANN401 - PyTorch's
        self._networks.clear()
        return super()._apply(*args, **kwargs)

    def _make_vmap(self) -> None:
        self._vmap_qnetworkN0 = self._critics

    def _critics(self, inputs: TensorDictBase, params: TensorDictBase) -> TensorDictBase:
        """``inputs`` of batch size ``[B]`` to values ``[E, B, 1]``."""
        if params is self.qvalue_network_params:
            name = "critics"
        elif params is self.target_qvalue_network_params:
            name = "target critics"
        else:
            name, params = "detached critics", self.qvalue_network_params.data
        critics = self._networks.get(name, self.qvalue_network, lambda: params)
        value = values(critics, inputs).unsqueeze(-1)
        return TensorDict({self.tensor_keys.state_action_value: value}, value.shape[:-1])
