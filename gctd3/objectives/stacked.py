"""Evaluate a loss's networks without a ``vmap``, and without swapping parameters in and out at every call."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor
from torchrl.objectives import SoftUpdate

from gctd3 import compat
from gctd3.errors import PerformanceWarning
from gctd3.nn import kernels
from gctd3.nn.kernels import lerp_all
from gctd3.nn.plain_module import PLAIN
from gctd3.nn.stacking import obstacles


class Networks:
    """Hold copies of a loss's networks, each with one of its sets of parameters for good.

    The copies share the parameters' memory, so optimisers, target updates and ``load_state_dict``, which all write in
    place, reach them too. Only moving the loss makes new tensors: then :meth:`clear` the copies.
    """

    def __init__(self) -> None:
        self._held: dict[str, TensorDictModule] = {}

    def get(self, name: str, network: TensorDictModule, params: Callable[[], TensorDictBase]) -> TensorDictModule:
        """Return the copy of ``network`` that is known as ``name``, made with ``params()`` at first."""
        if name not in self._held:
            held, given = copy.deepcopy(network), params()
            given.to_module(held)
            if not any(value.requires_grad for value in given.values(True, True)):
                # Otherwise the module would turn them into parameters, and collect gradients that nobody reads.
                held.requires_grad_(False)
            self._held[name] = held
        return self._held[name]

    def clear(self) -> None:
        """Forget the copies."""
        self._held.clear()

    def __deepcopy__(self, memo: dict[int, object]) -> Networks:
        # A copied loss has parameters of its own.
        return Networks()


class StackedLoss(compat.LossHooks):
    """Decide how a TorchRL loss evaluates its critics; stands before the loss among the bases of a class.

    Attributes:
        stacked: Whether the critics run as one module with parameters stacked to ``[E, ...]``. They do if every module
            of every critic is declared to take such parameters (:mod:`gctd3.nn.stacking`). Otherwise TorchRL's ``vmap``
            evaluates them, which is slower, and a :class:`.PerformanceWarning` says so when the loss is made. Where
            plain versions are asked for (:mod:`gctd3.nn.kernels`), they never do, without a warning.
    """

    stacked = False
    _copies: Networks

    def decide(
        self, critics: TensorDictModuleBase | Sequence[TensorDictModuleBase], actor: TensorDictModuleBase
    ) -> None:
        """Decide from the networks how the critics are evaluated, after TorchRL's constructor.

        Args:
            critics: The critics that the loss was made with, or the one that it made several of.
            actor: The actor.
        """
        self._copies = Networks()
        several = critics if isinstance(critics, (list, tuple)) else [critics]
        # set_keys may still change the action's name; the only output of an actor is its action.
        action = self.tensor_keys.action if len(actor.out_keys) > 1 else actor.out_keys[0]  # type: ignore[attr-defined]
        outside = tuple(key for key in actor.out_keys if key != action)
        reasons = [obstacle for critic in several for obstacle in obstacles(critic, outside)]
        self.stacked = not reasons and not kernels.plain()
        if reasons:
            warnings.warn(
                f"{type(self).__name__} evaluates its critics by TorchRL's vmap, which is slower than one batched "
                f"module: {reasons[0]} (gctd3.nn.stacking).",
                PerformanceWarning,
                stacklevel=3,
            )

    def parameters_move(self) -> None:
        """Forget the copies that hold the old parameters."""
        self._copies.clear()

    def more_in_keys(self) -> list[Any]:
        """Name the keys of the next state that critics read and the actor does not."""
        critic, action = self.qvalue_network, self.tensor_keys.action  # type: ignore[attr-defined]
        return [("next", key) for key in critic.in_keys if key != action]


def output(
    network: TensorDictModuleBase, inputs: TensorDictBase, key: str, replaced: Mapping[Any, Tensor] | None = None
) -> Tensor:
    """Return the output ``key`` of ``network``, without writing it.

    Args:
        network: Any network; one that wraps a single plain module is called on tensors, which spares a TensorDict's
            overhead.
        inputs: Inputs that hold ``network.in_keys``, batch size ``[*]``; left as it is.
        key: Key of the output.
        replaced: Inputs to take instead of the ones in ``inputs``, by their keys.
    """
    replaced = replaced or {}
    if type(network) in PLAIN and network.out_keys == [key]:
        given = [replaced[k] if k in replaced else inputs.get(k) for k in network.in_keys]
        return network.module(*given)
    return network(inputs.copy().update(replaced)).get(key)


def values(
    critic: TensorDictModuleBase, inputs: TensorDictBase, replaced: Mapping[Any, Tensor] | None = None
) -> Tensor:
    """Return the action values of one batch.

    Args:
        critic: Critic of :func:`gctd3.make_critic`, or any that is declared to take stacked parameters.
        inputs: Inputs that hold ``critic.in_keys``, batch size ``[*]``.
        replaced: Inputs to take instead of the ones in ``inputs``, by their keys.

    Returns:
        ``[*]``, or ``[E, *]`` if the critic's parameters are stacked to ``[E, ...]``.
    """
    return output(critic, inputs, critic.out_keys[0], replaced).squeeze(-1)


class FusedSoftUpdate(SoftUpdate):
    """Compute :class:`torchrl.objectives.SoftUpdate` of all parameters in one call instead of one call for each.

    Make it after the loss is on its device.
    """

    _lists: tuple[list[Tensor], list[Tensor]] | None = None

    def step(self) -> None:
        """Move the targets towards the trained parameters."""
        if self._lists is None:
            targets, sources = compat.update_pairs(self)
            self._lists = _leaves(targets), _leaves(sources)
        lerp_all(*self._lists, 1.0 - self.eps)


def _leaves(tensordict: TensorDictBase) -> list[Tensor]:
    return [value.data for _, value in sorted(tensordict.flatten_keys(".").items())]
