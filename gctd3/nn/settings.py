"""Settings of the networks: the kind and the sizes that actors and critics share."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from gctd3.errors import ConfigError

MOST_LAYERS, MOST_UNITS, MOST_WEIGHTS = 100, 16_384, 100_000_000
Mixing = Literal["local", "alternating"]
Scale = Literal["softplus", "exp"]


@dataclass(frozen=True)
class Network:
    """Set the kind and the sizes of a network: an encoder of the nodes, and fully connected layers after it.

    Sizes are Table 4's; layer normalisation is not the paper's.

    Attributes:
        graph_layers: Features after each graph convolution; ``[]`` for an MLP on the same input.
        hidden: Units of each fully connected layer.
        norm: Layer before each fully connected ReLU: ``layer`` (normalisation, arXiv:1607.06450) or ``none`` (the
            paper).
        graph_norm: Layer between each graph convolution and its ReLU: ``layer`` (normalisation) or ``none`` (the
            paper).
        residual: Add each graph layer's input to its output (arXiv:1512.03385).
        chebyshev: Order K of Chebyshev layers (the paper's equation 5, arXiv:1606.09375); ``None`` for the paper's
            layers of equation 7.
        mixing: ``alternating``: every second graph layer mixes all nodes with all (arXiv:2408.06316), with
            residual=true; ``local``: none does.
        readout: ``flat``: the nodes side by side (Figure 3); ``joint``: one head for all joints
            (:class:`.JointReadout`), and a pool for critics (:class:`.PooledReadout`), whose weights fit every robot.
        equivariant: Treat left and right alike, exactly, by averaging over the robot and its mirror image
            (arXiv:2110.03336).
    """

    graph_layers: Sequence[int] = (32, 32, 16)
    hidden: Sequence[int] = (256, 256)
    norm: Literal["none", "layer"] = "layer"
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
