"""Fully connected layers that also run a stack of networks at once.

PyTorch's own layers, with one addition: when their parameters carry a leading dimension ``E`` (as a TorchRL loss stacks
those of its critics), the forward pass is one batched matrix product over the ``E`` networks instead of a ``vmap``.
"""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from gctd3.nn.kernels import stacked_layers, stacked_linear
from gctd3.nn.stacking import stackable_layer


@stackable_layer
class Linear(nn.Linear):
    """Apply :class:`torch.nn.Linear`; weights ``[E, O, I]`` map ``[B, I]`` or ``[E, B, I]`` to ``[E, B, O]``."""

    def forward(self, input: Tensor) -> Tensor:
        """Apply the layer, or all layers of a stack."""
        if self.weight.ndim == 2:
            return functional.linear(input, self.weight, self.bias)
        return stacked_linear(input, self.weight, self.bias)


@stackable_layer
class LayerNorm(nn.LayerNorm):
    """Apply :class:`torch.nn.LayerNorm` to the last dimension; parameters ``[E, D]`` take ``[E, B, D]``."""

    def forward(self, input: Tensor) -> Tensor:
        """Apply the layer, or all layers of a stack."""
        if self.weight.ndim == 1:
            return super().forward(input)
        normal = functional.layer_norm(input, self.normalized_shape, eps=self.eps)
        return torch.addcmul(self.bias.unsqueeze(-2), normal, self.weight.unsqueeze(-2))


@stackable_layer
class MLP(nn.Sequential):
    """Apply layers as :class:`torch.nn.Sequential`, and stacked linear layers with ReLU between them in one call.

    Args:
        *layers: Layers of the network; the last is a :class:`Linear`.
    """

    def __init__(self, *layers: nn.Module) -> None:
        super().__init__(*layers)
        self._plain = all(type(layer) is (nn.ReLU if i % 2 else Linear) for i, layer in enumerate(layers))

    def forward(self, input: Tensor) -> Tensor:
        """Apply the layers, or those of all networks of a stack."""
        linear = cast("list[Linear]", list(self)[::2])
        if self._plain and linear[0].weight.ndim == 3:
            return stacked_layers(input, *(p for layer in linear for p in (layer.weight, layer.bias)))
        out: Tensor = super().forward(input)  # type: ignore[no-untyped-call]
        return out
