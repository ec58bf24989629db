"""The kind and the sizes of a network, as one setting that actors and critics share."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from torch import nn

from gctd3.errors import ConfigError
from gctd3.nn.encoder import FlatEncoder, GraphEncoder, Mixing
from gctd3.nn.equivariance import Symmetric
from gctd3.nn.layers import MLP, LayerNorm, Linear
from gctd3.nn.readout import JointReadout, PooledReadout
from gctd3.robots.graph import KinematicGraph
from gctd3.tasks.reflection import Reflection

MOST_LAYERS, MOST_UNITS, MOST_WEIGHTS = 100, 16_384, 100_000_000


@dataclass(frozen=True)
class Network:
    """An encoder of the nodes and the fully connected layers after it; the defaults are Table 4's.

    Attributes:
        graph_layers: Features after each graph convolution; none for an MLP on the same input.
        hidden: Units of each fully connected layer.
        norm: ``"layer"`` for layer normalisation (arXiv:1607.06450) before each fully connected ReLU, or ``"none"``.
        graph_norm: The same between graph convolution and ReLU.
        residual: Whether to add each graph layer's input to its output (arXiv:1512.03385).
        chebyshev: Order of Chebyshev layers (the paper's equation 5, arXiv:1606.09375) in place of the paper's
            first-order ones; ``None`` for those.
        mixing: ``"alternating"``: every second graph layer mixes all nodes with all (arXiv:2408.06316); ``"local"``:
            none does.
        readout: ``"flat"``: the nodes side by side (Figure 3); ``"joint"``: one head for all joints
            (:class:`.JointReadout`) and a pool for critics (:class:`.PooledReadout`), whose weights fit every robot.
        equivariant: Whether left and right are treated alike, exactly (:class:`.Symmetric`).
    """

    graph_layers: Sequence[int] = (32, 32, 16)
    hidden: Sequence[int] = (256, 256)
    norm: Literal["none", "layer"] = "none"
    graph_norm: Literal["none", "layer"] = "none"
    residual: bool = False
    chebyshev: int | None = None
    mixing: Mixing = "local"
    readout: Literal["flat", "joint"] = "flat"
    equivariant: bool = False

    def __post_init__(self) -> None:
        for name, sizes in (("graph_layers", self.graph_layers), ("hidden", self.hidden)):
            if any(size < 1 for size in sizes):
                raise ConfigError(f"{name} must hold sizes of at least 1, got {list(sizes)}.")
            if len(sizes) > MOST_LAYERS or any(size > MOST_UNITS for size in sizes):
                raise ConfigError(
                    f"{name} must hold at most {MOST_LAYERS} sizes of at most {MOST_UNITS:,}, got {list(sizes)}."
                )
            weights = sum(size * following for size, following in itertools.pairwise(sizes))
            if weights > MOST_WEIGHTS:
                raise ConfigError(
                    f"{name} must hold sizes with at most {MOST_WEIGHTS:,} weights between them, got {weights:,}."
                )
        if not self.hidden:
            raise ConfigError("hidden must hold at least one size, got [].")
        if self.chebyshev is not None and not 0 <= self.chebyshev <= MOST_LAYERS:
            raise ConfigError(
                f"chebyshev must be an order of at least 0 and at most {MOST_LAYERS}, or null, got {self.chebyshev}."
            )
        if self.mixing == "alternating" and not self.residual:
            raise ConfigError(
                "mixing must be local unless residual is true, got alternating: a layer that mixes all nodes "
                "with all makes them equal, and only what is added to it tells them apart."
            )
        plain = {"graph_norm": "none", "residual": False, "chebyshev": None, "mixing": "local"}
        idle = [name for name, value in plain.items() if getattr(self, name) != value]
        if idle and not self.graph_layers:
            raise ConfigError(f"graph_layers must hold at least one size for {', '.join(idle)} to act on, got [].")

    def encoder(self, graph: KinematicGraph, in_features: int) -> GraphEncoder | FlatEncoder:
        """A fresh encoder of ``[*, N, in_features]``."""
        if not self.graph_layers and self.readout == "flat":
            return FlatEncoder(graph, in_features)
        return GraphEncoder(
            graph,
            in_features,
            self.graph_layers,
            norm=self.graph_norm == "layer",
            residual=self.residual,
            chebyshev=self.chebyshev,
            mixing=self.mixing,
            # What every robot's joints share is to load on every robot.
            persistent=self.readout == "flat",
        )

    def head(self, in_features: int, out_features: int) -> nn.Module:
        """Fresh fully connected layers, ``[*, in_features]`` to ``[*, out_features]``."""
        return MLP(*self._layers(in_features, *self.hidden), Linear(self.hidden[-1], out_features))

    def joint_readout(self, graph: KinematicGraph, width: int, action_dim: int, per_action: int) -> JointReadout:
        """A fresh head that all joints share, ``[N, B, width]`` to ``[B, per_action * action_dim]``."""
        return JointReadout(graph, action_dim, self.head(2 * width, per_action))

    def pooled_readout(
        self, graph: KinematicGraph, width: int, action_dim: int, privileged_dim: int = 0
    ) -> PooledReadout:
        """Fresh layers of a value: the first of ``hidden`` at every node ``[N, B, width]``, the others pooled."""
        first, *rest = self.hidden
        sizes = [first + privileged_dim, *rest]
        each = nn.Sequential(*self._layers(width + 1, first))
        return PooledReadout(graph, action_dim, each, MLP(*self._layers(*sizes), Linear(sizes[-1], 1)))

    def symmetry(
        self, reflection: Reflection | None, in_features: int, action_dim: int, per_action: int
    ) -> Symmetric | None:
        """What makes the network's output equivariant, or a value (``per_action`` 0) invariant, if it is to be.

        Raises:
            ConfigError: If it is to be, and ``reflection`` is missing.
        """
        if not self.equivariant:
            return None
        if reflection is None:
            raise ConfigError("equivariant: true needs the reflection=Reflection.from_robot(robot).")
        return Symmetric(reflection, in_features, action_dim, per_action)

    def _layers(self, *sizes: int) -> list[nn.Module]:
        layers: list[nn.Module] = []
        for size, following in itertools.pairwise(sizes):
            layers.append(Linear(size, following))
            if self.norm == "layer":
                layers.append(LayerNorm(following))
            layers.append(nn.ReLU(inplace=True))
        return layers
