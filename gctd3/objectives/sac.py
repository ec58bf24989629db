"""SAC's loss (Haarnoja et al. 2018, arXiv:1812.05905), over TorchRL's."""

from __future__ import annotations

from tensordict import TensorDict, TensorDictBase
from torchrl.objectives import SACLoss as TorchRLSACLoss

from gctd3.objectives.stacked import stacked_values


class SACLoss(TorchRLSACLoss):
    """:class:`torchrl.objectives.SACLoss` with the critics' stacked parameters run as one batched module.

    Same constructor and keys, same losses and gradients; version 2 of the algorithm only (no value network).
    """

    def _make_vmap(self) -> None:
        self._vmap_qnetworkN0 = self._critics

    def _critics(self, inputs: TensorDictBase, params: TensorDictBase) -> TensorDictBase:
        """``inputs`` of batch size ``[B]`` to values ``[E, B, 1]``."""
        values = stacked_values(self.qvalue_network, params, inputs).unsqueeze(-1)
        return TensorDict({self.tensor_keys.state_action_value: values}, values.shape[:-1])
