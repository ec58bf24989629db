"""Fully connected layers that also run a stack of networks at once.

PyTorch's own layers, with one addition: when their parameters carry a leading dimension ``E`` (as a TorchRL loss stacks
those of its critics), the forward pass is one batched matrix product over the ``E`` networks instead of a ``vmap``.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn import functional


class _StackedLinear(torch.autograd.Function):
    """``E`` linear maps at once, with gradients in the layout of their parameters (autograd's own need a copy each)."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:  # noqa: ANN401 - PyTorch's
        ctx.save_for_backward(x, weight)
        return _stacked_product(x, weight, bias)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:  # noqa: ANN401 - PyTorch's
        x, weight = ctx.saved_tensors
        for_x = for_weight = for_bias = None
        if ctx.needs_input_grad[0]:
            for_x = gradient @ weight
            for_x = for_x if x.ndim == 3 else for_x.sum(0)
        if ctx.needs_input_grad[1]:
            for_weight = gradient.mT @ x.expand(len(weight), *x.shape[-2:])
        if ctx.needs_input_grad[2]:
            for_bias = gradient.sum(-2)
        return for_x, for_weight, for_bias


def stacked_linear(x: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
    """``x @ weight.mT + bias`` for each of ``E`` networks; differentiable once.

    Shapes:
        ``x`` ``[B, I]`` (shared) or ``[E, B, I]``, ``weight`` ``[E, O, I]``, ``bias`` ``[E, O]``; output ``[E, B, O]``.
    """
    if bias is None:
        return x @ weight.mT
    if not torch.is_grad_enabled():
        return _stacked_product(x, weight, bias)
    out: Tensor = _StackedLinear.apply(x, weight, bias)  # type: ignore[no-untyped-call]
    return out


def _stacked_product(x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    return torch.baddbmm(bias.unsqueeze(-2), x.expand(len(weight), *x.shape[-2:]), weight.mT)


class Linear(nn.Linear):
    """As :class:`torch.nn.Linear`; weights ``[E, O, I]`` map ``[B, I]`` or ``[E, B, I]`` to ``[E, B, O]``."""

    def forward(self, input: Tensor) -> Tensor:
        """Apply the layer, or all of a stack."""
        if self.weight.ndim == 2:
            return functional.linear(input, self.weight, self.bias)
        return stacked_linear(input, self.weight, self.bias)


class LayerNorm(nn.LayerNorm):
    """As :class:`torch.nn.LayerNorm` over the last dimension; parameters stacked to ``[E, D]`` take ``[E, B, D]``."""

    def forward(self, input: Tensor) -> Tensor:
        """Apply the layer, or all of a stack."""
        if self.weight.ndim == 1:
            return super().forward(input)
        normal = functional.layer_norm(input, self.normalized_shape, eps=self.eps)
        return torch.addcmul(self.bias.unsqueeze(-2), normal, self.weight.unsqueeze(-2))
