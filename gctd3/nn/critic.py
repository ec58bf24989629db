"""Action-value networks, from node features and an action to a value."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import torch
from torch import Tensor, nn

from gctd3.errors import ConfigError
from gctd3.nn.encoder import GraphEncoder
from gctd3.nn.network import make_encoder, make_head, make_pooled_readout, make_symmetry
from gctd3.nn.readout import PooledReadout
from gctd3.nn.stacking import stackable_network
from gctd3.robots.graph import KinematicGraph
from gctd3.tasks.reflection import Reflection

if TYPE_CHECKING:
    from gctd3.nn.settings import Network

VALUE = "state_action_value"
PRIVILEGED = "counters"


@stackable_network
class Critic(nn.Module):
    """Estimate the value of an action from node features, the action and the privileged input of the critic.

    The action and the privileged input are concatenated to the encoder's output, after the flatten (Figure 3); fully
    connected layers map them to the value.

    Args:
        network: Sizes and kind of the network.
        graph: The robot's graph.
        in_features: ``F``, features of a node over all stacked frames.
        action_dim: ``A``, number of actions.
        privileged_dim: Length of the privileged input, which only the critic gets.
        reflection: The robot's mirror symmetry, if ``network.equivariant``.

    Raises:
        ConfigError: If the reflection is missing or does not fit the inputs.

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
        self.encoder = make_encoder(network, graph, in_features)
        self.head: nn.Module
        if isinstance(self.encoder, GraphEncoder) and network.readout == "joint":
            self.head = make_pooled_readout(network, graph, self.encoder.width, action_dim, privileged_dim)
        else:
            self.head = make_head(network, self.encoder.out_features + action_dim + privileged_dim, 1)
        self.symmetry = make_symmetry(network, reflection, in_features, action_dim, per_action=0)
        if self.symmetry is not None and reflection is not None:
            reflected = len(reflection.counters.source)
            if privileged_dim not in (0, reflected):
                raise ConfigError(
                    f"equivariant: true needs a reflection of all {privileged_dim} numbers of the extra input, got one "
                    f"of {reflected}: a task's own is task.reflection()."
                )

    def forward(self, nodes: Tensor, action: Tensor, *privileged: Tensor) -> Tensor:
        """Estimate the value of ``action`` at ``nodes``; ``[E, *, 1]`` with parameters stacked to ``[E, ...]``."""
        batch, beside = nodes.shape[:-2], [action, *privileged]
        if len(batch) != 1:
            # As one batch dimension: layers with stacked parameters take a dimension before it for the stack's.
            rows = [x.expand(*batch, x.shape[-1]).reshape(-1, x.shape[-1]) for x in beside]
            value = self(nodes.reshape(-1, *nodes.shape[-2:]), *rows)
            return value.reshape(*value.shape[:-2], *batch, 1)
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
