"""The kind and the sizes of a network, as one setting that actors and critics share."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from torch import nn

from gctd3.errors import ConfigError
from gctd3.graph import KinematicGraph
from gctd3.nn.encoder import FlatEncoder, GraphEncoder
from gctd3.nn.layers import LayerNorm, Linear


@dataclass(frozen=True)
class Network:
    """An encoder of the nodes and the fully connected layers after it; the defaults are Table 4's.

    Attributes:
        graph_layers: Features after each graph convolution; none for an MLP on the same input.
        hidden: Units of each fully connected layer.
        norm: ``"layer"`` for layer normalisation (arXiv:1607.06450) before each fully connected ReLU, or ``"none"``.
    """

    graph_layers: Sequence[int] = (32, 32, 16)
    hidden: Sequence[int] = (256, 256)
    norm: Literal["none", "layer"] = "none"

    def __post_init__(self) -> None:
        for name, sizes in (("graph_layers", self.graph_layers), ("hidden", self.hidden)):
            if any(size < 1 for size in sizes):
                raise ConfigError(f"{name} must hold sizes of at least 1, got {list(sizes)}.")
        if not self.hidden:
            raise ConfigError("hidden must hold at least one size, got [].")

    def encoder(self, graph: KinematicGraph, in_features: int) -> GraphEncoder | FlatEncoder:
        """A fresh encoder of ``[*, N, in_features]``."""
        if self.graph_layers:
            return GraphEncoder(graph, in_features, self.graph_layers)
        return FlatEncoder(graph, in_features)

    def head(self, in_features: int, out_features: int) -> nn.Module:
        """Fresh fully connected layers, ``[*, in_features]`` to ``[*, out_features]``."""
        sizes = [in_features, *self.hidden]
        layers: list[nn.Module] = []
        for size, following in itertools.pairwise(sizes):
            layers.append(Linear(size, following))
            if self.norm == "layer":
                layers.append(LayerNorm(following))
            layers.append(nn.ReLU(inplace=True))
        return nn.Sequential(*layers, Linear(sizes[-1], out_features))
