"""Evaluating a loss's stacked critics in one batched pass instead of a ``vmap``."""

from __future__ import annotations

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor


def stacked_values(critic: TensorDictModule, params: TensorDictBase, inputs: TensorDictBase) -> Tensor:
    """Values of one batch under each network of a stack.

    Args:
        critic: The module whose parameters ``params`` replaces; one of :func:`gctd3.make_critic`, or any whose layers
            take stacked parameters.
        params: Parameters, stacked to ``[E, ...]``, or of a single network.
        inputs: Holds ``critic.in_keys``, batch size ``[B]``.

    Returns:
        ``[E, B]``, or ``[B]`` for a single network.
    """
    with params.to_module(critic, preserve_module_state=False):
        return critic.module(*(inputs.get(key) for key in critic.in_keys)).squeeze(-1)
