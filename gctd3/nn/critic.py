"""Action values: node features and an action to a number."""

from __future__ import annotations

from typing import cast

import torch
from tensordict.nn import TensorDictModule
from torch import Tensor, nn

from gctd3.errors import ConfigError
from gctd3.nn.actor import ACTION, NODES
from gctd3.nn.encoder import GraphEncoder
from gctd3.nn.network import Network
from gctd3.nn.readout import PooledReadout
from gctd3.robots.graph import KinematicGraph
from gctd3.tasks.reflection import Reflection

VALUE = "state_action_value"
PRIVILEGED = "counters"


class Critic(nn.Module):
    """Encoder, then the action (and what only the critic may see) beside its output, fully connected layers, a value.

    The action joins after the flatten (Figure 3).

    Args:
        network: Sizes and kind of the network.
        graph: The robot's graph.
        in_features: ``F``, features of a node over all stacked frames.
        action_dim: ``A``, number of actions.
        privileged_dim: Length of the extra input.
        reflection: How the robot looks in the mirror, if ``network.equivariant``.

    Raises:
        ConfigError: If the reflection is missing, or of other inputs.

    Shapes:
        inputs ``[*, N, F]``, ``[*, A]`` and, if ``privileged_dim > 0``, ``[*, privileged_dim]``; output ``[*, 1]``.
    """

    def __init__(
        self,
        network: Network,
        graph: KinematicGraph,
        in_features: int,
        action_dim: int,
        privileged_dim: int = 0,
        reflection: Reflection | None = None,
    ) -> None:
        super().__init__()
        self.encoder = network.encoder(graph, in_features)
        self.head: nn.Module
        if isinstance(self.encoder, GraphEncoder) and network.readout == "joint":
            self.head = network.pooled_readout(graph, self.encoder.width, action_dim, privileged_dim)
        else:
            self.head = network.head(self.encoder.out_features + action_dim + privileged_dim, 1)
        self.symmetry = network.symmetry(reflection, in_features, action_dim, per_action=0)
        if self.symmetry is not None and reflection is not None:
            reflected = len(reflection.counters.source)
            if privileged_dim not in (0, reflected):
                raise ConfigError(
                    f"equivariant: true needs a reflection of all {privileged_dim} numbers of the extra input, got one "
                    f"of {reflected}: a task's own is task.reflection()."
                )

    def forward(self, nodes: Tensor, action: Tensor, *privileged: Tensor) -> Tensor:
        """Value of ``action`` in the state ``nodes``; ``[E, B, 1]`` with parameters stacked to ``[E, ...]``."""
        if self.symmetry is None:
            return self._value(nodes, action, *privileged)
        return self.symmetry(self._value, nodes, action, *privileged)

    def _value(self, nodes: Tensor, *beside: Tensor) -> Tensor:
        if not isinstance(self.head, PooledReadout):
            code = self.encoder(nodes)
            return self.head(torch.cat([code, *(x.expand(*code.shape[:-1], x.shape[-1]) for x in beside)], dim=-1))
        codes = cast(GraphEncoder, self.encoder).codes(nodes)
        value = self.head(codes, *(x.reshape(-1, x.shape[-1]) for x in beside))
        return value if value.ndim == 3 else value.reshape(*nodes.shape[:-2], 1)


def make_critic(
    graph: KinematicGraph,
    in_features: int = 10,
    action_dim: int = 6,
    network: Network | None = None,
    privileged_dim: int = 0,
    reflection: Reflection | None = None,
) -> TensorDictModule:
    """An action-value network.

    Args:
        graph: The robot's graph.
        in_features: ``F``, features of a node over all stacked frames.
        action_dim: ``A``, number of actions.
        network: Sizes and kind; the paper's GCN by default.
        privileged_dim: Length of ``"counters"``, which the critic then reads too; 0 for none.
        reflection: How the robot looks in the mirror, for an equivariant network.

    Returns:
        A module that reads ``"nodes"`` ``[*, N, F]`` and ``"action"`` ``[*, A]`` and writes ``"state_action_value"``
        ``[*, 1]``.
    """
    module = Critic(network or Network(), graph, in_features, action_dim, privileged_dim, reflection)
    extra = [PRIVILEGED] if privileged_dim else []
    return TensorDictModule(module, in_keys=[NODES, ACTION, *extra], out_keys=[VALUE])
