"""A network of one's own, in plain torch.nn: every node through the same small network, then the mean over the nodes.

Train with it:

    PYTHONPATH=examples/extending/network python -m gctd3.train \
        --config-dir=examples/extending/network network=pooled
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from gctd3.errors import ConfigError
from gctd3.nn.settings import NetworkSettings
from gctd3.robots.graph import KinematicGraph
from gctd3.tasks.reflection import Reflection


class Pooled(nn.Module):
    """Map nodes, and what stands beside them, to a vector; nodes are told apart by an embedding of their own.

    Shapes:
        inputs ``[*, N, F]`` and any ``[*, D]``, output ``[*, outputs]``.
    """

    def __init__(self, nodes: int, in_features: int, beside: int, units: int, outputs: int) -> None:
        super().__init__()
        self.names = nn.Parameter(0.1 * torch.randn(nodes, in_features))
        self.each = nn.Sequential(nn.Linear(in_features, units), nn.ELU(), nn.Linear(units, units), nn.ELU())
        self.all = nn.Sequential(
            nn.Linear(units + beside, units), nn.LayerNorm(units), nn.ELU(), nn.Linear(units, outputs)
        )

    def forward(self, nodes: Tensor, *beside: Tensor) -> Tensor:
        """Encode every node, take the mean, and decide."""
        return self.all(torch.cat([self.each(nodes + self.names).mean(dim=-2), *beside], dim=-1))


@dataclass(frozen=True)
class PooledSettings(NetworkSettings):
    """Set the sizes of a pooled network.

    Attributes:
        units: Units of each layer.
    """

    units: int = 128

    def __post_init__(self) -> None:
        if self.units < 1:
            raise ConfigError(f"units must be at least 1, got {self.units}.")

    def actor(
        self,
        graph: KinematicGraph,
        in_features: int,
        action_dim: int,
        per_action: int,
        squash: bool,
        reflection: Reflection | None,
    ) -> nn.Module:
        """Build a policy."""
        network = Pooled(graph.num_nodes, in_features, 0, self.units, per_action * action_dim)
        return nn.Sequential(network, nn.Tanh()) if squash else network

    def critic(
        self,
        graph: KinematicGraph,
        in_features: int,
        action_dim: int,
        privileged_dim: int,
        reflection: Reflection | None,
    ) -> nn.Module:
        """Build an action value."""
        return Pooled(graph.num_nodes, in_features, action_dim + privileged_dim, self.units, 1)
