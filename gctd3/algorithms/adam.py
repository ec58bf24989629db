"""Adam (Kingma and Ba 2015, arXiv:1412.6980) without what PyTorch does around its kernel."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from gctd3.nn.kernels import adam_step


class Adam(torch.optim.Adam):
    """:class:`torch.optim.Adam` with ``fused=True``: same steps and state, less around them.

    To find and group the tensors anew at every step takes longer than the step of a small network. Here they are found
    once, and again when other parameters have gradients than before.

    Args:
        parameters: One group, of one device and dtype.
        lr: Learning rate.
    """

    _found: _Found | None = None

    def __init__(self, parameters: Iterable[nn.Parameter], lr: float) -> None:
        super().__init__(list(parameters), lr=lr, fused=True)

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__(state)  # type: ignore[no-untyped-call]
        self._found = None

    def zero_grad(self, set_to_none: bool = True) -> None:
        """Forget the gradients."""
        if not set_to_none:
            super().zero_grad(set_to_none=False)
            return
        for parameter in self.param_groups[0]["params"]:
            parameter.grad = None

    def step(self, closure: Callable[[], Any] | None = None) -> Any:  # noqa: ANN401 - PyTorch's
        """Take one step."""
        found = self._found
        if closure is not None or found is None or found.changed():
            loss = super().step(closure)
            self._find()
            return loss
        gradients: list[Any] = [parameter.grad for parameter in found.moved]
        adam_step(found.moved, gradients, *found.state, self.param_groups[0])
        return None

    def _find(self) -> None:
        parameters = self.param_groups[0]["params"]
        moved = [p for p in parameters if p.grad is not None]
        first, second, steps = ([self.state[p][key] for p in moved] for key in ("exp_avg", "exp_avg_sq", "step"))
        self._found = _Found(moved, [p for p in parameters if p.grad is None], (first, second, steps))


class _Found(NamedTuple):
    """Parameters that had gradients at the last step, those that had none, and the state of the former."""

    moved: list[Tensor]
    resting: list[Tensor]
    state: tuple[list[Tensor], list[Tensor], list[Tensor]]

    def changed(self) -> bool:
        return (
            not self.moved or any(p.grad is None for p in self.moved) or any(p.grad is not None for p in self.resting)
        )
