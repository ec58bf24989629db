"""Actors and critics as TensorDictModules, for any kind of network."""

from __future__ import annotations

from typing import get_args

from tensordict.nn import NormalParamExtractor, TensorDictModule, TensorDictModuleBase
from torch import nn
from torchrl.data import Bounded
from torchrl.modules import ProbabilisticActor, TanhNormal

from gctd3.errors import ConfigError
from gctd3.nn.actor import ACTION, NODES, ClippedExp
from gctd3.nn.critic import PRIVILEGED, VALUE
from gctd3.nn.plain_module import PlainModule
from gctd3.nn.settings import Network, NetworkSettings, Scale
from gctd3.robots.graph import KinematicGraph
from gctd3.tasks.reflection import Reflection


def make_actor(
    graph: KinematicGraph,
    in_features: int = 10,
    action_dim: int = 6,
    network: NetworkSettings | None = None,
    reflection: Reflection | None = None,
) -> TensorDictModule:
    """Build a deterministic policy.

    Args:
        graph: The robot's graph.
        in_features: ``F``, features of a node over all stacked frames.
        action_dim: ``A``, number of actions.
        network: Kind and sizes; the GCN of :class:`.Network`'s defaults if ``None``.
        reflection: The robot's mirror symmetry, for an equivariant network.

    Returns:
        A module that reads ``"nodes"`` ``[*, N, F]`` and writes ``"action"`` ``[*, A]`` in [-1, 1].

    Example:
        >>> import torch, gctd3
        >>> from tensordict import TensorDict
        >>> actor = make_actor(gctd3.KinematicGraph.from_mjcf("biped"))
        >>> actor(TensorDict({"nodes": torch.zeros(4, 8, 10)}, [4]))["action"].shape
        torch.Size([4, 6])
    """
    module = (network or Network()).actor(graph, in_features, action_dim, 1, True, reflection)
    return PlainModule(module, in_keys=[NODES], out_keys=[ACTION])


def make_stochastic_actor(
    graph: KinematicGraph,
    in_features: int = 10,
    action_dim: int = 6,
    network: NetworkSettings | None = None,
    reflection: Reflection | None = None,
    scale: Scale = "softplus",
) -> TensorDictModuleBase:
    """Build a tanh-squashed Gaussian policy (SAC, arXiv:1812.05905); arguments as in :func:`make_actor`, and ``scale``.

    Args:
        graph: The robot's graph.
        in_features: ``F``, features of a node over all stacked frames.
        action_dim: ``A``, number of actions.
        network: Kind and sizes; the GCN of :class:`.Network`'s defaults if ``None``.
        reflection: The robot's mirror symmetry, for an equivariant network.
        scale: Function that maps the network's second output ``x`` to the standard deviation: ``softplus`` as in
            TorchRL, shifted so that 0 gives 1, and at least 0.01; ``exp`` of ``x`` clipped to :data:`LOG_SCALE`, as in
            the code of SAC's authors. Both begin near 1.

    Returns:
        A :class:`~torchrl.modules.ProbabilisticActor` that reads ``"nodes"`` ``[*, N, F]`` and writes ``"loc"``,
        ``"scale"`` and ``"action"``, each ``[*, A]``.

    Raises:
        ConfigError: If ``scale`` is unknown.
    """
    if scale not in get_args(Scale):
        raise ConfigError(f"scale must be one of {', '.join(get_args(Scale))}, got {scale!r}.")
    module = (network or Network()).actor(graph, in_features, action_dim, 2, False, reflection)
    extract = ClippedExp() if scale == "exp" else NormalParamExtractor()
    parameters = PlainModule(nn.Sequential(module, extract), in_keys=[NODES], out_keys=["loc", "scale"])
    return ProbabilisticActor(
        module=parameters,
        spec=Bounded(low=-1.0, high=1.0, shape=(action_dim,)),
        in_keys=["loc", "scale"],
        out_keys=[ACTION],
        distribution_class=TanhNormal,
        distribution_kwargs={"low": -1.0, "high": 1.0},
    )


def make_critic(
    graph: KinematicGraph,
    in_features: int = 10,
    action_dim: int = 6,
    network: NetworkSettings | None = None,
    privileged_dim: int = 0,
    reflection: Reflection | None = None,
) -> TensorDictModule:
    """Build an action-value network.

    Args:
        graph: The robot's graph.
        in_features: ``F``, features of a node over all stacked frames.
        action_dim: ``A``, number of actions.
        network: Kind and sizes; the GCN of :class:`.Network`'s defaults if ``None``.
        privileged_dim: Length of ``"counters"``, which the critic reads unless it is 0.
        reflection: The robot's mirror symmetry, for an equivariant network.

    Returns:
        A module that reads ``"nodes"`` ``[*, N, F]`` and ``"action"`` ``[*, A]`` and writes ``"state_action_value"``
        ``[*, 1]``.
    """
    module = (network or Network()).critic(graph, in_features, action_dim, privileged_dim, reflection)
    extra = [PRIVILEGED] if privileged_dim else []
    return PlainModule(module, in_keys=[NODES, ACTION, *extra], out_keys=[VALUE])
