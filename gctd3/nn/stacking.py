"""Declarations of networks that can run as a stack, with parameters ``[E, ...]`` of ``E`` networks in one module.

It is declared, never tried out: a class is declared with one of the decorators below, and a network is stackable if
every module in it is of a declared class or of one known here. A subclass has to be declared again, since it may
compute something else.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeVar

from tensordict.nn import TensorDictModuleBase
from torch import nn

from gctd3.compat import has_hooks
from gctd3.nn.plain_module import PLAIN

T = TypeVar("T", bound=type[nn.Module])

# PyTorch's modules without parameters that act elementwise, and its containers without a forward pass of their own.
_KNOWN: set[type[nn.Module]] = {
    nn.Sequential, nn.ModuleList, nn.Identity,
    nn.ReLU, nn.ReLU6, nn.LeakyReLU, nn.ELU, nn.SELU, nn.CELU, nn.GELU, nn.SiLU, nn.Mish,
    nn.Tanh, nn.Sigmoid, nn.Softplus, nn.Softsign, nn.Hardtanh, nn.Hardswish,
}  # fmt: skip
_NETWORKS: set[type[nn.Module]] = set()


def stackable_layer(layer: T) -> T:
    """Declare that a layer accepts parameters stacked to ``[E, ...]``, within a declared network.

    The layer then maps ``[B, ...]``, shared by all ``E``, and ``[E, B, ...]``, the output of an earlier layer of the
    stack, to ``[E, B, ...]``. Graph layers have their nodes before the batch where their docstrings say so.
    """
    _KNOWN.add(layer)
    return layer


def stackable_network(network: T) -> T:
    """Declare that a whole network accepts stacked parameters, to map ``[*, I]`` to ``[E, *, O]`` for any ``*``.

    Unlike a layer, it knows which dimensions of its inputs are features, and does not take a batch ``[E, B]`` for a
    stack.
    """
    _KNOWN.add(network)
    _NETWORKS.add(network)
    return network


def obstacles(network: TensorDictModuleBase, outside: tuple[str, ...] = ()) -> list[str]:
    """List the reasons why a network cannot run as a stack; empty if it can.

    Args:
        network: The network, in a TensorDictModule.
        outside: Keys that other networks write; a stack reads its inputs from the batch.
    """
    if type(network) not in PLAIN:
        return [f"{_name(network)} around the network is not a plain TensorDictModule"]
    if len(network.out_keys) != 1:
        return [f"the network writes {len(network.out_keys)} keys"]
    if made := [str(key) for key in network.in_keys if key in outside]:
        return [f"the network reads outputs of another one: {', '.join(made)}"]
    if unknown := sorted(set(_unknown(network.module))):
        return [f"not declared to take stacked parameters: {', '.join(unknown)}"]
    if type(network.module) not in _NETWORKS:
        return [f"not declared to be a whole network: {_name(network.module)}"]
    return []


def _unknown(module: nn.Module) -> Iterator[str]:
    for part in module.modules():
        if type(part) not in _KNOWN or "forward" in vars(part) or has_hooks(part):
            yield _name(part)


def _name(module: nn.Module) -> str:
    kind = type(module)
    return f"{kind.__module__.partition('.')[0]}'s {kind.__qualname__}"
