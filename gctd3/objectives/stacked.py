"""Evaluating a loss's networks without a ``vmap``, and without swapping parameters in and out at every call."""

from __future__ import annotations

import copy
from collections.abc import Callable

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor
from torchrl.objectives import SoftUpdate


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
            held, given = copy.deepcopy(network), params()
            given.to_module(held)
            if not any(value.requires_grad for value in given.values(True, True)):
                # Or the module would make parameters of them, and a loss collect gradients that nobody reads.
                held.requires_grad_(False)
            self._held[name] = held
        return self._held[name]

    def clear(self) -> None:
        """Forget the copies."""
        self._held.clear()

    def __deepcopy__(self, memo: dict[int, object]) -> Networks:
        # A copied loss has parameters of its own.
        return Networks()


def output(network: TensorDictModuleBase, inputs: TensorDictBase, key: str, **replaced: Tensor) -> Tensor:
    """What ``network`` writes as ``key``, without writing it.

    Args:
        network: Any; one that wraps a single plain module is called on tensors, which spares a TensorDict's overhead.
        inputs: Holds ``network.in_keys``, batch size ``[B]``; left as it is.
        key: Of the output.
        **replaced: Inputs to take instead of the ones in ``inputs``.
    """
    if type(network) is TensorDictModule and network.out_keys == [key]:
        given = [replaced[k] if k in replaced else inputs.get(k) for k in network.in_keys]
        return network.module(*given)
    return network(inputs.copy().update(replaced)).get(key)


def values(critic: TensorDictModule, inputs: TensorDictBase, **replaced: Tensor) -> Tensor:
    """Action values of one batch.

    Args:
        critic: One of :func:`gctd3.make_critic`, or any whose layers take stacked parameters.
        inputs: Holds ``critic.in_keys``, batch size ``[B]``.
        **replaced: Inputs to take instead of the ones in ``inputs``.

    Returns:
        ``[B]``, or ``[E, B]`` if the critic's parameters are stacked to ``[E, ...]``.
    """
    return output(critic, inputs, critic.out_keys[0], **replaced).squeeze(-1)


class FusedSoftUpdate(SoftUpdate):
    """:class:`torchrl.objectives.SoftUpdate` of all parameters in one call instead of one call for each.

    Make it after the loss is on its device.
    """

    def step(self) -> None:
        """Move the targets towards the trained parameters."""
        if "_lists" not in self.__dict__:
            self.__dict__["_lists"] = (_leaves(self._targets), _leaves(self._sources))
        targets, sources = self.__dict__["_lists"]
        torch._foreach_lerp_(targets, sources, 1.0 - self.eps)


def _leaves(tensordict: TensorDictBase) -> list[Tensor]:
    return [value.data for _, value in sorted(tensordict.flatten_keys(".").items())]
