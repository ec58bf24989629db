"""Encoders, the part of the networks that depends on the graph: node features to one vector, or one for each node."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, cast

import numpy as np
import torch
from torch import Tensor, nn

from gctd3.nn.graph_conv import ChebyshevConv, GraphConv, GraphLayer
from gctd3.nn.layers import LayerNorm, Linear
from gctd3.nn.stacking import stackable_layer
from gctd3.robots.graph import KinematicGraph

if TYPE_CHECKING:
    from gctd3.nn.settings import Mixing


@stackable_layer
class GraphEncoder(nn.Module):
    r"""Encode node features by graph convolutions with ReLU, and concatenate them (Figure 3, equation 14).

    A layer computes :math:`\mathrm{ReLU}(\mathrm{norm}(\mathrm{conv}(X)) + \mathrm{skip}(X))`; the paper's has neither
    norm nor skip.

    Args:
        graph: The graph, or its propagation matrix ``[N, N]``.
        in_features: ``F``, features of a node over all stacked frames.
        hidden: Features of a node after each layer; the paper's are ``[32, 32, 16]``.
        norm: Whether to normalise every node's features after each convolution (Ba et al. 2016, arXiv:1607.06450).
        residual: Whether to add each layer's input to its output, through a linear map if their widths differ (He et
            al. 2016, arXiv:1512.03385, equations 1 and 2).
        chebyshev: Order ``K`` of :class:`.ChebyshevConv`; ``None`` for :class:`.GraphConv`.
        mixing: ``local``: every layer mixes along the graph's edges; ``alternating``: every second one mixes all nodes
            with all (Sferrazza et al. 2024, arXiv:2408.06316).
        persistent: Whether the state dictionary holds the graph; without it, it fits every graph.

    Shapes:
        input ``[*, N, F]``, output ``[*, N * hidden[-1]]``.

    Raises:
        ValueError: If ``chebyshev`` is given with a propagation matrix, which has no Chebyshev polynomials.
    """

    def __init__(
        self,
        graph: KinematicGraph | np.ndarray | Tensor,
        in_features: int,
        hidden: Sequence[int] = (32, 32, 16),
        *,
        norm: bool = False,
        residual: bool = False,
        chebyshev: int | None = None,
        mixing: Mixing = "local",
        persistent: bool = True,
    ) -> None:
        super().__init__()
        sizes = [in_features, *hidden]
        self.num_nodes = graph.num_nodes if isinstance(graph, KinematicGraph) else len(graph)
        self.layers = nn.ModuleList(
            _convolution(a, b, _complete(graph) if mixing == "alternating" and i % 2 else graph, chebyshev, persistent)
            for i, (a, b) in enumerate(itertools.pairwise(sizes))
        )
        self.norms = nn.ModuleList(LayerNorm(size) for size in hidden) if norm else None
        self.skips = nn.ModuleList(map(_skip, sizes, sizes[1:])) if residual else None
        self.width = sizes[-1]
        self.out_features = self.num_nodes * self.width

    def forward(self, nodes: Tensor) -> Tensor:
        """Encode ``nodes [*, N, F]``; parameters stacked to ``[E, ...]`` give ``[E, B, out_features]``."""
        x = self.codes(nodes)
        x = x.transpose(-3, -2).flatten(-2)
        return x if x.ndim == 3 else x.reshape(*nodes.shape[:-2], self.out_features)

    def codes(self, nodes: Tensor) -> Tensor:
        """Encode ``nodes [*, N, F]`` to ``[(E,) N, B, width]``, where ``B`` is the product of the dimensions ``*``."""
        return self.node_first(nodes.reshape(-1, *nodes.shape[-2:]).transpose(0, 1))

    def node_first(self, nodes: Tensor) -> Tensor:
        """Encode ``nodes [N, B, F]`` without concatenating the nodes.

        Returns:
            ``[N, B, width]``; ``[E, N, B, width]`` if the parameters are stacked to ``[E, ...]``.
        """
        x, rows = nodes, nodes.shape[-3:-1]
        for i, layer in enumerate(self.layers):
            y = cast(GraphLayer, layer).node_first(x)
            # Norms and skips know no nodes: to them every node of every state is a row.
            if self.norms is not None:
                y = self.norms[i](y.flatten(-3, -2)).unflatten(-2, rows)
            if self.skips is not None:
                y = y + self.skips[i](x.flatten(-3, -2)).unflatten(-2, rows)
            x = torch.relu_(y)
        return x


@stackable_layer
class FlatEncoder(nn.Module):
    """Join the features of all nodes, as the input of an MLP.

    Shapes:
        input ``[*, N, F]``, output ``[*, N * F]``.
    """

    def __init__(self, graph: KinematicGraph | np.ndarray | Tensor, in_features: int) -> None:
        super().__init__()
        nodes = graph.num_nodes if isinstance(graph, KinematicGraph) else len(graph)
        self.out_features = nodes * in_features

    def forward(self, nodes: Tensor) -> Tensor:
        """Join the features of ``nodes [*, N, F]``."""
        return nodes.flatten(-2)


def _convolution(
    in_features: int,
    out_features: int,
    graph: KinematicGraph | np.ndarray | Tensor,
    chebyshev: int | None,
    persistent: bool,
) -> GraphLayer:
    if chebyshev is None:
        matrix = graph.normalized_adjacency if isinstance(graph, KinematicGraph) else graph
        return GraphConv(in_features, out_features, matrix, persistent=persistent)
    if not isinstance(graph, KinematicGraph):
        raise ValueError("Chebyshev layers need a KinematicGraph, got a propagation matrix.")
    return ChebyshevConv(in_features, out_features, graph.chebyshev(chebyshev), persistent=persistent)


def _complete(graph: KinematicGraph | np.ndarray | Tensor) -> KinematicGraph | np.ndarray:
    """Return the complete graph of the same nodes, or the propagation matrix of it."""
    if not isinstance(graph, KinematicGraph):
        return np.full((len(graph), len(graph)), 1.0 / len(graph))
    return KinematicGraph(graph.nodes, 1.0 - np.eye(graph.num_nodes))


def _skip(in_features: int, out_features: int) -> nn.Module:
    return nn.Identity() if in_features == out_features else Linear(in_features, out_features, bias=False)
