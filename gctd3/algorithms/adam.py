"""Adam (Kingma and Ba 2015, arXiv:1412.6980) without PyTorch's overhead around its kernel."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from gctd3.nn.kernels import adam_step


class Adam(torch.optim.Adam):
    """Implement :class:`torch.optim.Adam` with ``fused=True``: the same steps and state, with less overhead.

    To collect and group the tensors at every step takes longer than the step of a small network. Here they are
    collected once, and again when the set of parameters with gradients changes.

    Args:
        parameters: Parameters of one group, on one device and of one dtype.
        lr: Learning rate.
    """

    _updated: _Updated | None = None

    def __init__(self, parameters: Iterable[nn.Parameter], lr: float) -> None:
        super().__init__(list(parameters), lr=lr, fused=True)

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__(state)  # type: ignore[no-untyped-call]
        self._updated = None

    def zero_grad(self, set_to_none: bool = True) -> None:
        """Reset the gradients: to ``None``, or to zero without ``set_to_none``."""
        if not set_to_none:
            super().zero_grad(set_to_none=False)
            return
        for parameter in self.param_groups[0]["params"]:
            parameter.grad = None

    def step(self, closure: Callable[[], Any] | None = None) -> Any:  # noqa: ANN401 - PyTorch's
        """Take one optimisation step."""
        updated = self._updated
        if closure is not None or updated is None or updated.changed():
            loss = super().step(closure)
            self._find()
            return loss
        gradients: list[Any] = [parameter.grad for parameter in updated.moved]
        adam_step(updated.moved, gradients, *updated.state, self.param_groups[0])
        return None

    def _find(self) -> None:
        parameters = self.param_groups[0]["params"]
        moved = [p for p in parameters if p.grad is not None]
        first, second, steps = ([self.state[p][key] for p in moved] for key in ("exp_avg", "exp_avg_sq", "step"))
        self._updated = _Updated(moved, [p for p in parameters if p.grad is None], (first, second, steps))


class _Updated(NamedTuple):
    """Hold the parameters with gradients at the last step and their state, and the parameters without."""

    moved: list[Tensor]
    resting: list[Tensor]
    state: tuple[list[Tensor], list[Tensor], list[Tensor]]

    def changed(self) -> bool:
        return (
            not self.moved or any(p.grad is None for p in self.moved) or any(p.grad is not None for p in self.resting)
        )
