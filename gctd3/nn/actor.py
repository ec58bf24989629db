"""Policies: node features to desired joint angles in [-1, 1]."""

from __future__ import annotations

import torch
from tensordict.nn import NormalParamExtractor, TensorDictModule, TensorDictModuleBase
from torch import Tensor, nn
from torchrl.data import Bounded
from torchrl.modules import ProbabilisticActor, TanhNormal

from gctd3.graph import KinematicGraph
from gctd3.nn.network import Network

NODES, ACTION = "nodes", "action"


class Actor(nn.Module):
    """Encoder, fully connected layers, and a linear readout (Figure 3).

    Args:
        network: Sizes and kind of the network.
        graph: The robot's graph.
        in_features: ``F``, features of a node over all stacked frames.
        out_features: Length of the output.
        squash: Whether a tanh ends the network.

    Shapes:
        input ``[*, N, F]``, output ``[*, out_features]``.
    """

    def __init__(
        self, network: Network, graph: KinematicGraph, in_features: int, out_features: int, squash: bool = True
    ) -> None:
        super().__init__()
        self.encoder = network.encoder(graph, in_features)
        self.head = network.head(self.encoder.out_features, out_features)
        self.squash = squash

    def forward(self, nodes: Tensor) -> Tensor:
        """Act on ``nodes [*, N, F]``."""
        out = self.head(self.encoder(nodes))
        return torch.tanh(out) if self.squash else out


def make_actor(
    graph: KinematicGraph, in_features: int = 10, action_dim: int = 6, network: Network | None = None
) -> TensorDictModule:
    """A deterministic policy.

    Args:
        graph: The robot's graph.
        in_features: ``F``, features of a node over all stacked frames.
        action_dim: ``A``, number of actions.
        network: Sizes and kind; the paper's GCN by default.

    Returns:
        A module that reads ``"nodes"`` ``[*, N, F]`` and writes ``"action"`` ``[*, A]`` in [-1, 1].

    Example:
        >>> import torch, gctd3
        >>> from tensordict import TensorDict
        >>> actor = make_actor(gctd3.KinematicGraph.from_mjcf("biped"))
        >>> actor(TensorDict({"nodes": torch.zeros(4, 8, 10)}, [4]))["action"].shape
        torch.Size([4, 6])
    """
    module = Actor(network or Network(), graph, in_features, action_dim)
    return TensorDictModule(module, in_keys=[NODES], out_keys=[ACTION])


def make_stochastic_actor(
    graph: KinematicGraph, in_features: int = 10, action_dim: int = 6, network: Network | None = None
) -> TensorDictModuleBase:
    """A tanh-squashed Gaussian policy (SAC, arXiv:1812.05905).

    Returns:
        A :class:`~torchrl.modules.ProbabilisticActor` that reads ``"nodes"`` ``[*, N, F]`` and writes ``"loc"``,
        ``"scale"`` and ``"action"``, each ``[*, A]``.
    """
    module = Actor(network or Network(), graph, in_features, 2 * action_dim, squash=False)
    parameters = TensorDictModule(
        nn.Sequential(module, NormalParamExtractor(scale_lb=1e-3)), in_keys=[NODES], out_keys=["loc", "scale"]
    )
    return ProbabilisticActor(
        module=parameters,
        spec=Bounded(low=-1.0, high=1.0, shape=(action_dim,)),
        in_keys=["loc", "scale"],
        out_keys=[ACTION],
        distribution_class=TanhNormal,
        distribution_kwargs={"low": -1.0, "high": 1.0},
    )
