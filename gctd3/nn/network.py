"""Parts of a network, built from its settings."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

from torch import nn

from gctd3.errors import ConfigError
from gctd3.nn.encoder import FlatEncoder, GraphEncoder
from gctd3.nn.equivariance import Symmetric
from gctd3.nn.layers import MLP, LayerNorm, Linear
from gctd3.nn.readout import JointReadout, PooledReadout
from gctd3.robots.graph import KinematicGraph
from gctd3.tasks.reflection import Reflection

if TYPE_CHECKING:
    from gctd3.nn.settings import Network


def make_encoder(network: Network, graph: KinematicGraph, in_features: int) -> GraphEncoder | FlatEncoder:
    """Build an encoder of node features ``[*, N, in_features]``."""
    if not network.graph_layers and network.readout == "flat":
        return FlatEncoder(graph, in_features)
    return GraphEncoder(
        graph,
        in_features,
        network.graph_layers,
        norm=network.graph_norm == "layer",
        residual=network.residual,
        chebyshev=network.chebyshev,
        mixing=network.mixing,
        # Weights that all joints share must load for every robot.
        persistent=network.readout == "flat",
    )


def make_head(network: Network, in_features: int, out_features: int) -> nn.Module:
    """Build fully connected layers, ``[*, in_features]`` to ``[*, out_features]``."""
    return MLP(*_layers(network, in_features, *network.hidden), Linear(network.hidden[-1], out_features))


def make_joint_readout(
    network: Network, graph: KinematicGraph, width: int, action_dim: int, per_action: int
) -> JointReadout:
    """Build a readout that all joints share, ``[N, B, width]`` to ``[B, per_action * action_dim]``."""
    return JointReadout(graph, action_dim, make_head(network, 2 * width, per_action))


def make_pooled_readout(
    network: Network, graph: KinematicGraph, width: int, action_dim: int, privileged_dim: int = 0
) -> PooledReadout:
    """Build a readout of a value: the first of ``hidden`` at every node ``[N, B, width]``, the others pooled."""
    first, *rest = network.hidden
    sizes = [first + privileged_dim, *rest]
    each = nn.Sequential(*_layers(network, width + 1, first))
    return PooledReadout(graph, action_dim, each, MLP(*_layers(network, *sizes), Linear(sizes[-1], 1)))


def make_symmetry(
    network: Network, reflection: Reflection | None, in_features: int, action_dim: int, per_action: int
) -> Symmetric | None:
    """Build the module that makes a network equivariant (a value: invariant, ``per_action`` 0), if set; else ``None``.

    Raises:
        ConfigError: If the network is equivariant and ``reflection`` is missing.
    """
    if not network.equivariant:
        return None
    if reflection is None:
        raise ConfigError("equivariant: true needs the reflection=Reflection.from_robot(robot).")
    return Symmetric(reflection, in_features, action_dim, per_action)


def _layers(network: Network, *sizes: int) -> list[nn.Module]:
    layers: list[nn.Module] = []
    for size, following in itertools.pairwise(sizes):
        layers.append(Linear(size, following))
        if network.norm == "layer":
            layers.append(LayerNorm(following))
        layers.append(nn.ReLU(inplace=True))
    return layers
