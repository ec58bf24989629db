"""Adam (Kingma and Ba 2015, arXiv:1412.6980) without what PyTorch does around its kernel."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import torch
from torch import Tensor, nn


class Adam(torch.optim.Adam):
    """:class:`torch.optim.Adam` with ``fused=True``: same steps and state, less around them.

    To find and group the tensors anew at every step takes longer than the step of a small network. Here they are found
    once; so parameters that get no gradient at first never get any.

    Args:
        parameters: One group, of one device and dtype.
        lr: Learning rate.
    """

    def __init__(self, parameters: Iterable[nn.Parameter], lr: float) -> None:
        super().__init__(list(parameters), lr=lr, fused=True)

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__(state)  # type: ignore[no-untyped-call]
        self._found: tuple[list[nn.Parameter], list[list[Tensor]]] | None = None

    def zero_grad(self, set_to_none: bool = True) -> None:
        """Forget the gradients."""
        if not set_to_none:
            super().zero_grad(set_to_none=False)
            return
        for parameter in self.param_groups[0]["params"]:
            parameter.grad = None

    def step(self, closure: Callable[[], Any] | None = None) -> Any:  # noqa: ANN401 - PyTorch's
        """One step."""
        if closure is not None or self.__dict__.get("_found") is None:
            loss = super().step(closure)
            self._find()
            return loss
        group, (parameters, state) = self.param_groups[0], self.__dict__["_found"]
        first, second, steps = state
        beta1, beta2 = group["betas"]
        torch._foreach_add_(steps, 1)
        torch._fused_adam_(
            parameters,
            [parameter.grad for parameter in parameters],
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
        return None

    def _find(self) -> None:
        """The parameters that have a state, and what it consists of."""
        parameters = [p for p in self.param_groups[0]["params"] if p in self.state]
        state = [[self.state[p][key] for p in parameters] for key in ("exp_avg", "exp_avg_sq", "step")]
        self._found = parameters, state
