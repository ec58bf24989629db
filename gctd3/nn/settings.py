"""Settings of the networks: the kind and the sizes that actors and critics share."""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from gctd3.errors import ConfigError

if TYPE_CHECKING:
    from torch import nn

    from gctd3.robots.graph import KinematicGraph
    from gctd3.tasks.reflection import Reflection

MOST_LAYERS, MOST_UNITS, MOST_WEIGHTS = 100, 16_384, 100_000_000
Mixing = Literal["local", "alternating"]
Scale = Literal["softplus", "exp"]


@dataclass(frozen=True)
class NetworkSettings(ABC):
    """Hold the settings of actors and critics; a network of your own is a subclass, and may use plain ``torch.nn``.

    Class attributes:
        equivariant: Whether the networks are built with the robot's reflection.
        knows_graph: Whether the networks need the robot's graph, beside the features of its nodes.
        shares_joints: Whether all joints have the same weights, so that their order does not matter.
    """

    # Without annotations, which would make fields of them, the first ones of every subclass.
    equivariant = False
    knows_graph = False
    shares_joints = False

    @abstractmethod
    def actor(
        self,
        graph: KinematicGraph,
        in_features: int,
        action_dim: int,
        per_action: int,
        squash: bool,
        reflection: Reflection | None,
    ) -> nn.Module:
        """Build an actor from nodes ``[*, N, in_features]`` to ``[*, per_action * action_dim]``.

        Args:
            graph: The robot's graph.
            in_features: ``F``, features of a node over all stacked frames.
            action_dim: ``A``, number of actions.
            per_action: Numbers for each action; the output holds the first of all actions, then the second.
            squash: Whether a tanh ends the network.
            reflection: The robot's mirror symmetry, if ``equivariant``.
        """

    @abstractmethod
    def critic(
        self,
        graph: KinematicGraph,
        in_features: int,
        action_dim: int,
        privileged_dim: int,
        reflection: Reflection | None,
    ) -> nn.Module:
        """Build a critic from nodes ``[*, N, in_features]``, an action and a privileged input to a value ``[*, 1]``.

        Args:
            graph: The robot's graph.
            in_features: ``F``, features of a node over all stacked frames.
            action_dim: ``A``, number of actions; the action is ``[*, A]``.
            privileged_dim: Length of the privileged input ``[*, privileged_dim]``; 0 for no such input.
            reflection: The robot's mirror symmetry, if ``equivariant``.
        """


@dataclass(frozen=True)
class Network(NetworkSettings):
    """Hold the kind and the sizes of a network: an encoder of the nodes, and fully connected layers after it.

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

    @property
    def knows_graph(self) -> bool:  # type: ignore[override]
        """Return whether any part of the network needs the robot's graph."""
        return bool(self.graph_layers) or self.readout != "flat" or self.equivariant

    @property
    def shares_joints(self) -> bool:  # type: ignore[override]
        """Return whether all joints have the same weights."""
        return bool(self.graph_layers) and self.readout == "joint"

    def actor(
        self,
        graph: KinematicGraph,
        in_features: int,
        action_dim: int,
        per_action: int,
        squash: bool,
        reflection: Reflection | None,
    ) -> nn.Module:
        """Build an :class:`.Actor`."""
        from gctd3.nn.actor import Actor

        return Actor(self, graph, in_features, action_dim, per_action, squash, reflection)

    def critic(
        self,
        graph: KinematicGraph,
        in_features: int,
        action_dim: int,
        privileged_dim: int,
        reflection: Reflection | None,
    ) -> nn.Module:
        """Build a :class:`.Critic`."""
        from gctd3.nn.critic import Critic

        return Critic(self, graph, in_features, action_dim, privileged_dim, reflection)
