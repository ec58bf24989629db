"""Fully connected layers that also run a stack of networks at once.

PyTorch's own layers, with one addition: when their parameters carry a leading dimension ``E`` (as a TorchRL loss stacks
those of its critics), the forward pass is one batched matrix product over the ``E`` networks instead of a ``vmap``.
"""

from __future__ import annotations

from typing import Any, cast

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn import functional

from gctd3.nn.stacking import stackable_layer


class _Stacked(torch.autograd.Function):
    """Linear layers with ReLU between them, of ``E`` networks at once, and their gradients by hand.

    One node of autograd's graph instead of two for each layer, activations and their gradients overwritten in place,
    and gradients in the layout of their parameters, of which autograd's own need a copy each.
    """

    @staticmethod
    def forward(ctx: Any, x: Tensor, *parameters: Tensor) -> Tensor:  # noqa: ANN401 - PyTorch's
        passed = _layers(x, *parameters)
        ctx.save_for_backward(*passed[:-1], *parameters[::2])
        return passed[-1]

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:  # noqa: ANN401 - PyTorch's
        layers = len(ctx.saved_tensors) // 2
        passed, weights = ctx.saved_tensors[:layers], ctx.saved_tensors[layers:]
        needed = ctx.needs_input_grad
        found: list[Tensor | None] = [None] * len(needed)
        for i in reversed(range(layers)):
            x, weight = passed[i], weights[i]
            if needed[1 + 2 * i]:
                found[1 + 2 * i] = torch.bmm(gradient.mT, x.expand(len(weight), *x.shape[-2:]))
            if needed[2 + 2 * i]:
                found[2 + 2 * i] = gradient.sum(-2)
            if not any(needed[: 1 + 2 * i]):
                break
            gradient = torch.bmm(gradient, weight)
            if i:
                torch.ops.aten.threshold_backward.grad_input(gradient, x, 0, grad_input=gradient)
            else:
                found[0] = gradient if x.ndim == 3 else gradient.sum(0)
        return tuple(found)


def _layers(x: Tensor, *parameters: Tensor) -> list[Tensor]:
    """What goes into each of the layers, and what comes out of the last."""
    passed = [x]
    for weight, bias in zip(parameters[::2], parameters[1::2], strict=True):
        if len(passed) > 1:
            torch.relu_(passed[-1])
        x = passed[-1].expand(len(weight), *passed[-1].shape[-2:])
        passed.append(torch.baddbmm(bias.unsqueeze(-2), x, weight.mT))
    return passed


def stacked_layers(x: Tensor, *parameters: Tensor) -> Tensor:
    """Linear layers with ReLU between them, of ``E`` networks at once; differentiable once.

    Args:
        x: Input ``[B, I]``, which all share, or ``[E, B, I]``.
        *parameters: Of each layer its weight ``[E, O, I]`` and its bias ``[E, O]``.

    Returns:
        ``[E, B, O]``.
    """
    if not torch.is_grad_enabled():
        return _layers(x, *parameters)[-1]
    out: Tensor = _Stacked.apply(x, *parameters)  # type: ignore[no-untyped-call]
    return out


def stacked_linear(x: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
    """``x @ weight.mT + bias`` for each of ``E`` networks; differentiable once.

    Shapes:
        ``x`` ``[B, I]`` (shared) or ``[E, B, I]``, ``weight`` ``[E, O, I]``, ``bias`` ``[E, O]``; output ``[E, B, O]``.
    """
    return x @ weight.mT if bias is None else stacked_layers(x, weight, bias)


@stackable_layer
class Linear(nn.Linear):
    """As :class:`torch.nn.Linear`; weights ``[E, O, I]`` map ``[B, I]`` or ``[E, B, I]`` to ``[E, B, O]``."""

    def forward(self, input: Tensor) -> Tensor:
        """Apply the layer, or all of a stack."""
        if self.weight.ndim == 2:
            return functional.linear(input, self.weight, self.bias)
        return stacked_linear(input, self.weight, self.bias)


@stackable_layer
class LayerNorm(nn.LayerNorm):
    """As :class:`torch.nn.LayerNorm` over the last dimension; parameters stacked to ``[E, D]`` take ``[E, B, D]``."""

    def forward(self, input: Tensor) -> Tensor:
        """Apply the layer, or all of a stack."""
        if self.weight.ndim == 1:
            return super().forward(input)
        normal = functional.layer_norm(input, self.normalized_shape, eps=self.eps)
        return torch.addcmul(self.bias.unsqueeze(-2), normal, self.weight.unsqueeze(-2))


@stackable_layer
class MLP(nn.Sequential):
    """As :class:`torch.nn.Sequential`; linear layers with ReLU between them run as one if their parameters are stacked.

    Args:
        *layers: The last is a :class:`Linear`.
    """

    def __init__(self, *layers: nn.Module) -> None:
        super().__init__(*layers)
        self._plain = all(type(layer) is (nn.ReLU if i % 2 else Linear) for i, layer in enumerate(layers))

    def forward(self, input: Tensor) -> Tensor:
        """Apply the layers, or those of all of a stack."""
        linear = cast("list[Linear]", list(self)[::2])
        if self._plain and linear[0].weight.ndim == 3:
            return stacked_layers(input, *(p for layer in linear for p in (layer.weight, layer.bias)))
        out: Tensor = super().forward(input)  # type: ignore[no-untyped-call]
        return out
