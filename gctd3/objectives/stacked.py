"""Evaluating a loss's networks without a ``vmap``, and without swapping parameters in and out at every call."""

from __future__ import annotations

import copy
from collections.abc import Callable

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor


class Networks:
    """Copies of a loss's networks, each holding one of its sets of parameters for good.

    The copies share the parameters' memory, so optimisers, target updates and ``load_state_dict``, which all write in
    place, reach them too. Only moving the loss makes new tensors: then :meth:`clear` them.
    """

    def __init__(self) -> None:
        self._held: dict[str, TensorDictModule] = {}

    def get(self, name: str, network: TensorDictModule, params: Callable[[], TensorDictBase]) -> TensorDictModule:
        """The copy of ``network`` that is known as ``name``, made with ``params()`` at first."""
        if name not in self._held:
            held = copy.deepcopy(network)
            params().to_module(held)
            self._held[name] = held
        return self._held[name]

    def clear(self) -> None:
        """Forget the copies."""
        self._held.clear()

    def __deepcopy__(self, memo: dict[int, object]) -> Networks:
        # A copied loss has parameters of its own.
        return Networks()


def values(critic: TensorDictModule, inputs: TensorDictBase) -> Tensor:
    """Action values of one batch.

    Args:
        critic: One of :func:`gctd3.make_critic`, or any whose layers take stacked parameters.
        inputs: Holds ``critic.in_keys``, batch size ``[B]``.

    Returns:
        ``[B]``, or ``[E, B]`` if the critic's parameters are stacked to ``[E, ...]``.
    """
    return torch.squeeze(critic.module(*(inputs.get(key) for key in critic.in_keys)), -1)
