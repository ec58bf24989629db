"""Policies: networks from node features to desired joint angles in [-1, 1]."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import torch
from torch import Tensor, nn

from gctd3.nn.encoder import GraphEncoder
from gctd3.nn.network import make_encoder, make_head, make_joint_readout, make_symmetry
from gctd3.nn.readout import JointReadout
from gctd3.nn.stacking import stackable_network
from gctd3.robots.graph import KinematicGraph
from gctd3.tasks.reflection import Reflection

if TYPE_CHECKING:
    from gctd3.nn.settings import Network

NODES, ACTION = "nodes", "action"
LOG_SCALE = (-20.0, 2.0)  # bounds to which the authors of SAC clip the log standard deviation


@stackable_network
class Actor(nn.Module):
    """Map node features to actions: an encoder, fully connected layers and a linear readout (Figure 3).

    Args:
        network: Sizes and kind of the network.
        graph: The robot's graph.
        in_features: ``F``, features of a node over all stacked frames.
        action_dim: ``A``, number of actions.
        per_action: Numbers for each action; the output holds the first of all actions, then the second.
        squash: Whether a tanh ends the network.
        reflection: The robot's mirror symmetry, if ``network.equivariant``.

    Shapes:
        input ``[*, N, F]``, output ``[*, per_action * A]``.
    """

    def __init__(
        self,
        network: Network,
        graph: KinematicGraph,
        in_features: int,
        action_dim: int,
        per_action: int = 1,
        squash: bool = True,
        reflection: Reflection | None = None,
    ) -> None:
        super().__init__()
        self.encoder = make_encoder(network, graph, in_features)
        self.head: nn.Module
        if isinstance(self.encoder, GraphEncoder) and network.readout == "joint":
            self.head = make_joint_readout(network, graph, self.encoder.width, action_dim, per_action)
        else:
            self.head = make_head(network, self.encoder.out_features, per_action * action_dim)
        self.symmetry = make_symmetry(network, reflection, in_features, action_dim, per_action)
        self.squash = squash

    def forward(self, nodes: Tensor) -> Tensor:
        """Compute the action for the node features ``nodes [*, N, F]``."""
        out = self._act(nodes) if self.symmetry is None else self.symmetry(self._act, nodes)
        return torch.tanh(out) if self.squash else out

    def _act(self, nodes: Tensor) -> Tensor:
        if not isinstance(self.head, JointReadout):
            return self.head(self.encoder(nodes))
        out = self.head(cast(GraphEncoder, self.encoder).codes(nodes))
        return out if out.ndim == 3 else out.reshape(*nodes.shape[:-2], out.shape[-1])


class ClippedExp(nn.Module):
    """Map an output ``[*, 2 * A]`` to mean and standard deviation, each ``[*, A]``, as SAC's authors do."""

    def forward(self, out: Tensor) -> tuple[Tensor, Tensor]:
        """Split ``out`` into mean and log standard deviation, clip the latter and exponentiate it."""
        loc, log_scale = out.chunk(2, dim=-1)
        return loc, log_scale.clamp(*LOG_SCALE).exp()
