"""Policies: node features to desired joint angles in [-1, 1]."""

from __future__ import annotations

from typing import cast, get_args

import torch
from tensordict.nn import NormalParamExtractor, TensorDictModule, TensorDictModuleBase
from torch import Tensor, nn
from torchrl.data import Bounded
from torchrl.modules import ProbabilisticActor, TanhNormal

from gctd3.errors import ConfigError
from gctd3.nn.encoder import GraphEncoder
from gctd3.nn.network import make_encoder, make_head, make_joint_readout, make_symmetry
from gctd3.nn.readout import JointReadout
from gctd3.nn.settings import Network, Scale
from gctd3.robots.graph import KinematicGraph
from gctd3.tasks.reflection import Reflection

NODES, ACTION = "nodes", "action"
LOG_SCALE = (-20.0, 2.0)  # between which the authors of SAC clip it


class Actor(nn.Module):
    """Encoder, fully connected layers, and a linear readout (Figure 3).

    Args:
        network: Sizes and kind of the network.
        graph: The robot's graph.
        in_features: ``F``, features of a node over all stacked frames.
        action_dim: ``A``, number of actions.
        per_action: Numbers for each action; the output holds the first of all actions, then the second.
        squash: Whether a tanh ends the network.
        reflection: How the robot looks in the mirror, if ``network.equivariant``.

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
        """Act on ``nodes [*, N, F]``."""
        out = self._act(nodes) if self.symmetry is None else self.symmetry(self._act, nodes)
        return torch.tanh(out) if self.squash else out

    def _act(self, nodes: Tensor) -> Tensor:
        if not isinstance(self.head, JointReadout):
            return self.head(self.encoder(nodes))
        out = self.head(cast(GraphEncoder, self.encoder).codes(nodes))
        return out if out.ndim == 3 else out.reshape(*nodes.shape[:-2], out.shape[-1])


class ClippedExp(nn.Module):
    """A network's output ``[*, 2 * A]`` to mean and standard deviation, each ``[*, A]``, as SAC's authors do."""

    def forward(self, out: Tensor) -> tuple[Tensor, Tensor]:
        """Split ``out`` and clip."""
        loc, log_scale = out.chunk(2, dim=-1)
        return loc, log_scale.clamp(*LOG_SCALE).exp()


def make_actor(
    graph: KinematicGraph,
    in_features: int = 10,
    action_dim: int = 6,
    network: Network | None = None,
    reflection: Reflection | None = None,
) -> TensorDictModule:
    """A deterministic policy.

    Args:
        graph: The robot's graph.
        in_features: ``F``, features of a node over all stacked frames.
        action_dim: ``A``, number of actions.
        network: Sizes and kind; GCN of :class:`.Network`'s defaults if ``None``.
        reflection: How the robot looks in the mirror, for an equivariant network.

    Returns:
        A module that reads ``"nodes"`` ``[*, N, F]`` and writes ``"action"`` ``[*, A]`` in [-1, 1].

    Example:
        >>> import torch, gctd3
        >>> from tensordict import TensorDict
        >>> actor = make_actor(gctd3.KinematicGraph.from_mjcf("biped"))
        >>> actor(TensorDict({"nodes": torch.zeros(4, 8, 10)}, [4]))["action"].shape
        torch.Size([4, 6])
    """
    module = Actor(network or Network(), graph, in_features, action_dim, reflection=reflection)
    return TensorDictModule(module, in_keys=[NODES], out_keys=[ACTION])


def make_stochastic_actor(
    graph: KinematicGraph,
    in_features: int = 10,
    action_dim: int = 6,
    network: Network | None = None,
    reflection: Reflection | None = None,
    scale: Scale = "softplus",
) -> TensorDictModuleBase:
    """A tanh-squashed Gaussian policy (SAC, arXiv:1812.05905); arguments as of :func:`make_actor`, and one more.

    Args:
        graph: The robot's graph.
        in_features: ``F``, features of a node over all stacked frames.
        action_dim: ``A``, number of actions.
        network: Sizes and kind; GCN of :class:`.Network`'s defaults if ``None``.
        reflection: How the robot looks in the mirror, for an equivariant network.
        scale: What makes the standard deviation of the network's second output ``x``: ``softplus`` as TorchRL has it,
            shifted so that 0 gives 1, and at least 0.01; ``exp`` of ``x`` clipped to :data:`LOG_SCALE`, as in the code
            of SAC's authors. Both begin near 1.

    Returns:
        A :class:`~torchrl.modules.ProbabilisticActor` that reads ``"nodes"`` ``[*, N, F]`` and writes ``"loc"``,
        ``"scale"`` and ``"action"``, each ``[*, A]``.

    Raises:
        ConfigError: If there is no such ``scale``.
    """
    if scale not in get_args(Scale):
        raise ConfigError(f"scale must be one of {', '.join(get_args(Scale))}, got {scale!r}.")
    module = Actor(
        network or Network(), graph, in_features, action_dim, per_action=2, squash=False, reflection=reflection
    )
    extract = ClippedExp() if scale == "exp" else NormalParamExtractor()
    parameters = TensorDictModule(nn.Sequential(module, extract), in_keys=[NODES], out_keys=["loc", "scale"])
    return ProbabilisticActor(
        module=parameters,
        spec=Bounded(low=-1.0, high=1.0, shape=(action_dim,)),
        in_keys=["loc", "scale"],
        out_keys=[ACTION],
        distribution_class=TanhNormal,
        distribution_kwargs={"low": -1.0, "high": 1.0},
    )
