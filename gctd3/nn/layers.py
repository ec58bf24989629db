"""Fully connected layers that also run a stack of networks at once.

PyTorch's own layers, with one addition: when their parameters carry a leading dimension ``E`` (as a TorchRL loss stacks
those of its critics), the forward pass is one batched matrix product over the ``E`` networks instead of a ``vmap``.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional


def stacked_linear(x: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
    """``x @ weight + bias`` for each of ``E`` networks.

    Shapes:
        ``x`` ``[B, I]`` (shared) or ``[E, B, I]``, ``weight`` ``[E, I, O]``, ``bias`` ``[E, O]``; output ``[E, B, O]``.
    """
    x = x.expand(weight.shape[0], *x.shape[-2:])
    if bias is None:
        return torch.bmm(x, weight)
    return torch.baddbmm(bias.unsqueeze(-2), x, weight)


class Linear(nn.Linear):
    """As :class:`torch.nn.Linear`; weights ``[E, O, I]`` map ``[B, I]`` or ``[E, B, I]`` to ``[E, B, O]``."""

    def forward(self, input: Tensor) -> Tensor:
        """Apply the layer, or all of a stack."""
        if self.weight.ndim == 2:
            return functional.linear(input, self.weight, self.bias)
        return stacked_linear(input, self.weight.mT, self.bias)


class LayerNorm(nn.LayerNorm):
    """As :class:`torch.nn.LayerNorm` over the last dimension; parameters stacked to ``[E, D]`` take ``[E, B, D]``."""

    def forward(self, input: Tensor) -> Tensor:
        """Apply the layer, or all of a stack."""
        if self.weight.ndim == 1:
            return super().forward(input)
        normal = functional.layer_norm(input, self.normalized_shape, eps=self.eps)
        return torch.addcmul(self.bias.unsqueeze(-2), normal, self.weight.unsqueeze(-2))
