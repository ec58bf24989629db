"""Which networks can run as a stack, with parameters ``[E, ...]`` of ``E`` networks in one module.

It is declared, never tried out: a class is declared with one of the decorators below, and a network is stackable if
every module in it is of a declared class or of one known here. A subclass has to be declared again, since it may
compute something else.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeVar

from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import nn

from gctd3.compat import has_hooks

T = TypeVar("T", bound=type[nn.Module])

# Of PyTorch's, those that hold nothing and act on every element alike, and containers without a forward of their own.
_KNOWN: set[type[nn.Module]] = {
    nn.Sequential, nn.ModuleList, nn.Identity,
    nn.ReLU, nn.ReLU6, nn.LeakyReLU, nn.ELU, nn.SELU, nn.CELU, nn.GELU, nn.SiLU, nn.Mish,
    nn.Tanh, nn.Sigmoid, nn.Softplus, nn.Softsign, nn.Hardtanh, nn.Hardswish,
}  # fmt: skip
_NETWORKS: set[type[nn.Module]] = set()


def stackable_layer(layer: T) -> T:
    """Declare a layer to take parameters stacked to ``[E, ...]``, in networks that are declared to.

    It then maps ``[B, ...]``, the same for all ``E``, and ``[E, B, ...]``, as an earlier layer of the stack gives it,
    to ``[E, B, ...]``. Graph layers have their nodes before the batch where their docstrings say so.
    """
    _KNOWN.add(layer)
    return layer


def stackable_network(network: T) -> T:
    """Declare a whole network to take stacked parameters: it maps inputs ``[*, I]`` to ``[E, *, O]`` for any ``*``.

    Unlike a layer it knows which dimensions of its inputs are features, so that a batch ``[E, B]`` is no stack to it.
    """
    _KNOWN.add(network)
    _NETWORKS.add(network)
    return network


def obstacles(network: TensorDictModuleBase, outside: tuple[str, ...] = ()) -> list[str]:
    """List what keeps a network from running as a stack, in words; nothing if it can.

    Args:
        network: The network, in a TensorDictModule.
        outside: Keys that other networks write; a stack reads its inputs from the batch.
    """
    if type(network) is not TensorDictModule:
        return [f"{_name(network)} around the network is not a plain TensorDictModule"]
    if len(network.out_keys) != 1:
        return [f"the network writes {len(network.out_keys)} keys"]
    if made := [str(key) for key in network.in_keys if key in outside]:
        return [f"the network reads what another one writes: {', '.join(made)}"]
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
