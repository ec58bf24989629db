"""Hand-optimised operations, each beside a reference version in plain PyTorch.

With ``GCTD3_PLAIN=1`` in the environment the plain versions are computed, and losses evaluate their critics by
TorchRL's ``vmap``: to find out whether a fault lies here. Results then agree to rounding, not to the last bit. In tests
:func:`use_plain` does the same. No other file reads the variable.

The gains are ratios of times, plain to fast, at batch 256 with the paper's networks: ``python benchmarks/kernels.py``,
both versions in turn, best of 100 rounds, one thread of one machine (AMD EPYC, torch 2.13). Elsewhere they differ. A
whole update of TD3 is 1.1 times as fast with them, and 1.5 times with one batched module in place of ``vmap``, too.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

VARIABLE = "GCTD3_PLAIN"

_plain = os.environ.get(VARIABLE, "") not in ("", "0")


def plain() -> bool:
    """Return whether the plain versions are computed."""
    return _plain


@contextmanager
def use_plain(yes: bool = True) -> Iterator[None]:
    """Compute plain or fast versions within a ``with`` block; losses keep those with which they were built."""
    global _plain
    before, _plain = _plain, yes
    try:
        yield
    finally:
        _plain = before


# Linear layers of a stack of networks


class _Stacked(torch.autograd.Function):
    """Compute linear layers with ReLU between them, of ``E`` networks at once, with hand-written gradients.

    It is one node of autograd's graph instead of two for each layer. Activations and their gradients are overwritten
    in place. Gradients have the layout of their parameters; autograd's own each need a copy.
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
        gradients: list[Tensor | None] = [None] * len(needed)
        for i in reversed(range(layers)):
            x, weight = passed[i], weights[i]
            if needed[1 + 2 * i]:
                gradients[1 + 2 * i] = torch.bmm(gradient.mT, x.expand(len(weight), *x.shape[-2:]))
            if needed[2 + 2 * i]:
                gradients[2 + 2 * i] = gradient.sum(-2)
            if not any(needed[: 1 + 2 * i]):
                break
            gradient = torch.bmm(gradient, weight)
            if i:
                torch.ops.aten.threshold_backward.grad_input(gradient, x, 0, grad_input=gradient)
            else:
                gradients[0] = gradient if x.ndim == 3 else gradient.sum(0)
        return tuple(gradients)


def _layers(x: Tensor, *parameters: Tensor) -> list[Tensor]:
    """Return the input of each layer, and the output of the last."""
    passed = [x]
    for weight, bias in zip(parameters[::2], parameters[1::2], strict=True):
        if len(passed) > 1:
            torch.relu_(passed[-1])
        x = passed[-1].expand(len(weight), *passed[-1].shape[-2:])
        passed.append(torch.baddbmm(bias.unsqueeze(-2), x, weight.mT))
    return passed


def stacked_layers(x: Tensor, *parameters: Tensor) -> Tensor:
    """Apply linear layers with ReLU between them, of ``E`` networks at once; differentiable once.

    The fast version is one hand-written node of autograd's graph; 1.1 times as fast, forward and backward.

    Args:
        x: Input ``[B, I]``, shared by all networks, or ``[E, B, I]``.
        *parameters: Weight ``[E, O, I]`` and bias ``[E, O]`` of each layer, in order.

    Returns:
        ``[E, B, O]``.
    """
    if _plain:
        return stacked_layers_plain(x, *parameters)
    if not torch.is_grad_enabled():
        return _layers(x, *parameters)[-1]
    out: Tensor = _Stacked.apply(x, *parameters)  # type: ignore[no-untyped-call]
    return out


def stacked_layers_plain(x: Tensor, *parameters: Tensor) -> Tensor:
    """Compute :func:`stacked_layers` with products and sums that autograd differentiates."""
    for i, (weight, bias) in enumerate(zip(parameters[::2], parameters[1::2], strict=True)):
        x = (torch.relu(x) if i else x) @ weight.mT + bias.unsqueeze(-2)
    return x


def stacked_linear(x: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
    """Compute ``x @ weight.mT + bias`` for each of ``E`` networks; differentiable once.

    Shapes:
        ``x`` ``[B, I]`` (shared) or ``[E, B, I]``, ``weight`` ``[E, O, I]``, ``bias`` ``[E, O]``; output ``[E, B, O]``.
    """
    return x @ weight.mT if bias is None else stacked_layers(x, weight, bias)


# Steps of optimisers and targets


def adam_step(
    parameters: list[Tensor],
    gradients: list[Tensor],
    first: list[Tensor],
    second: list[Tensor],
    steps: list[Tensor],
    group: dict[str, Any],
) -> None:
    """Take one step of Adam (arXiv:1412.6980, Algorithm 1) with all parameters, in place.

    The fast version calls ``torch._fused_adam_`` and ``torch._foreach_add_`` (torch 2.13.0) directly; 6 times as fast
    as the plain version, 1.2 times as fast as PyTorch's optimiser, which calls the same after collecting the tensors.

    Args:
        parameters: Parameters to update.
        gradients: Gradient of each parameter.
        first: Running mean of each gradient.
        second: Running mean of the square of each gradient.
        steps: Number of steps of each parameter, a tensor of one element.
        group: ``lr``, ``betas``, ``eps`` and ``weight_decay``.
    """
    if _plain:
        adam_step_plain(parameters, gradients, first, second, steps, group)
        return
    beta1, beta2 = group["betas"]
    torch._foreach_add_(steps, 1)
    torch._fused_adam_(
        parameters,
        gradients,
        first,
        second,
        [],
        steps,
        lr=group["lr"],
        beta1=beta1,
        beta2=beta2,
        weight_decay=group["weight_decay"],
        eps=group["eps"],
        amsgrad=False,
        maximize=False,
    )


@torch.no_grad()
def adam_step_plain(
    parameters: list[Tensor],
    gradients: list[Tensor],
    first: list[Tensor],
    second: list[Tensor],
    steps: list[Tensor],
    group: dict[str, Any],
) -> None:
    """Compute :func:`adam_step` as in the paper, one parameter after another."""
    beta1, beta2 = group["betas"]
    for parameter, given, mean, square, step in zip(parameters, gradients, first, second, steps, strict=True):
        gradient = given + group["weight_decay"] * parameter
        step += 1
        mean.mul_(beta1).add_((1 - beta1) * gradient)
        square.mul_(beta2).add_((1 - beta2) * gradient * gradient)
        mean_hat, square_hat = mean / (1 - beta1 ** float(step)), square / (1 - beta2 ** float(step))
        parameter.sub_(group["lr"] * mean_hat / (square_hat.sqrt() + group["eps"]))


def lerp_all(targets: list[Tensor], sources: list[Tensor], share: float) -> None:
    """Interpolate each target towards its source by ``share``, in place.

    The fast version is one call of ``torch._foreach_lerp_`` (torch 2.13.0) for all targets; 1.2 times as fast.
    """
    if _plain:
        lerp_all_plain(targets, sources, share)
    else:
        torch._foreach_lerp_(targets, sources, share)


def lerp_all_plain(targets: list[Tensor], sources: list[Tensor], share: float) -> None:
    """Compute :func:`lerp_all` one target after another."""
    for target, source in zip(targets, sources, strict=True):
        target.lerp_(source, share)


# Histories out of a ring of frames


def stack_frames(frames: Tensor, age: Tensor, place: Tensor, back: Tensor, robots: int) -> Tensor:
    """Stack the last frames up to each place, oldest first; the first frame of an episode stands for earlier ones.

    The fast version is one gather by places in the flat ring; 1.3 times as fast.

    Args:
        frames: The ring, rows and robots as one dimension, ``[rows * robots, N, F]``.
        age: Number of earlier frames of the same episode, as far as a stack reaches, ``[rows * robots]``.
        place: Row times ``robots`` plus robot, ``[B]``.
        back: Offset of each frame in a stack, in rows before the last, ``H - 1`` to 0, ``[H]``.
        robots: Number of robots, the columns of the ring.

    Returns:
        ``[B, N, H * F]``.
    """
    if _plain:
        return stack_frames_plain(frames, age, place, back, robots)
    rows = back.minimum(age.index_select(0, place)[:, None])
    places = (place[:, None] - rows * robots) % len(frames)
    stack = frames.index_select(0, places.reshape(-1))
    stack = stack.reshape(*places.shape, *stack.shape[1:])
    return stack.movedim(1, -2).flatten(-2)


def stack_frames_plain(frames: Tensor, age: Tensor, place: Tensor, back: Tensor, robots: int) -> Tensor:
    """Compute :func:`stack_frames` frame by frame, from rows and robots."""
    ring, ages = frames.reshape(-1, robots, *frames.shape[1:]), age.reshape(-1, robots)
    row, robot = place // robots, place % robots
    oldest = ages[row, robot].long()
    rows = [(row - oldest.clamp(max=k)) % len(ring) for k in back.tolist()]
    return torch.cat([ring[one, robot] for one in rows], dim=-1)
