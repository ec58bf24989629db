"""From node features to one vector: the part of the networks that knows the graph, or does not."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import cast

import numpy as np
import torch
from torch import Tensor, nn

from gctd3.graph import KinematicGraph
from gctd3.nn.graph_conv import GraphConv


class GraphEncoder(nn.Module):
    r"""Graph convolutions with ReLU, then the nodes' features side by side (Figure 3, equation 14).

    Args:
        graph: The graph, or its propagation matrix ``[N, N]``.
        in_features: ``F``, features of a node over all stacked frames.
        hidden: Features after each layer; the paper's are ``[32, 32, 16]``.

    Shapes:
        input ``[*, N, F]``, output ``[*, N * hidden[-1]]``.
    """

    def __init__(
        self, graph: KinematicGraph | np.ndarray | Tensor, in_features: int, hidden: Sequence[int] = (32, 32, 16)
    ) -> None:
        super().__init__()
        matrix = graph.normalized_adjacency if isinstance(graph, KinematicGraph) else graph
        sizes = [in_features, *hidden]
        self.layers = nn.ModuleList(GraphConv(a, b, matrix) for a, b in itertools.pairwise(sizes))
        self.out_features = len(matrix) * sizes[-1]

    def forward(self, nodes: Tensor) -> Tensor:
        """Encode ``nodes [*, N, F]``; parameters stacked to ``[E, ...]`` give ``[E, B, out_features]``."""
        batch = nodes.shape[:-2]
        x = nodes.reshape(-1, *nodes.shape[-2:]).transpose(0, 1)
        for layer in self.layers:
            x = torch.relu_(cast(GraphConv, layer).node_first(x))
        x = x.transpose(-3, -2).flatten(-2)
        return x if x.ndim == 3 else x.reshape(*batch, self.out_features)


class FlatEncoder(nn.Module):
    """The nodes' features side by side and nothing else: what an MLP sees.

    Shapes:
        input ``[*, N, F]``, output ``[*, N * F]``.
    """

    def __init__(self, graph: KinematicGraph | np.ndarray | Tensor, in_features: int) -> None:
        super().__init__()
        nodes = graph.num_nodes if isinstance(graph, KinematicGraph) else len(graph)
        self.out_features = nodes * in_features

    def forward(self, nodes: Tensor) -> Tensor:
        """Flatten ``nodes [*, N, F]``."""
        return nodes.flatten(-2)
