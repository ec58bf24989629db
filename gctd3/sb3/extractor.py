"""The features extractor of Stable-Baselines3 that encodes a robot's nodes by graph convolutions."""

from __future__ import annotations

import inspect
from collections.abc import Mapping

import torch
from gymnasium import spaces
from stable_baselines3.common.preprocessing import get_flattened_obs_dim
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor

from gctd3.errors import ConfigError, check_kind, suggest
from gctd3.nn.encoder import GraphEncoder
from gctd3.robots.graph import KinematicGraph


class GraphExtractor(BaseFeaturesExtractor):
    """Encode the observations of nodes by graph convolutions (Phan Bui et al. 2022, Figure 3).

    It is the ``features_extractor_class`` of a ``MultiInputPolicy``, for every algorithm of Stable-Baselines3. The
    fully connected layers after it are the policy's own ``net_arch``.

    Args:
        observation_space: A ``Dict`` with a vector of ``F`` numbers for each node of the graph. Entries of other names,
            as a goal, are appended to the features as they are.
        graph: The robot's graph, of :class:`.NodeObservation`.
        **encoder: Further arguments of :class:`.GraphEncoder`: ``hidden``, ``norm``, ``residual``, ``chebyshev``,
            ``mixing``.

    Attributes:
        nodes: Names of the nodes, in the order of the features.
        others: Names of the entries that are appended.
        encoder: The :class:`.GraphEncoder`.

    Shapes:
        input: for each node ``[B, F]``; output ``[B, N * hidden[-1] + C]``, node by node, with ``C`` numbers of other
        entries.

    Raises:
        ConfigError: If the space is not of this kind or lacks a node, or an argument is unknown.
    """

    def __init__(self, observation_space: spaces.Dict, graph: KinematicGraph, **encoder: object) -> None:
        check_kind("graph", graph, KinematicGraph)
        width = _width(observation_space, graph)
        known = [name for name, p in inspect.signature(GraphEncoder).parameters.items() if p.default is not p.empty]
        for name in encoder:
            if name not in known:
                raise ConfigError(f"GraphExtractor has no {name!r}; it has {', '.join(known)}.{suggest(name, known)}")
        encodes = GraphEncoder(graph, width, **encoder)  # type: ignore[arg-type]
        others = [name for name in observation_space.spaces if name not in graph.nodes]
        beside = sum(get_flattened_obs_dim(observation_space[name]) for name in others)
        super().__init__(observation_space, encodes.out_features + beside)
        self.nodes, self.others, self.encoder = graph.nodes, tuple(others), encodes

    def forward(self, observations: Mapping[str, Tensor]) -> Tensor:
        """Encode the observations of all nodes, and append the other entries."""
        nodes = torch.stack([observations[name] for name in self.nodes], dim=-2)
        beside = [observations[name].flatten(1) for name in self.others]
        return torch.cat([self.encoder(nodes), *beside], dim=-1)


def _width(space: spaces.Space[object], graph: KinematicGraph) -> int:
    """Return how many numbers the space has for each node."""
    if not isinstance(space, spaces.Dict):
        raise ConfigError(
            f"GraphExtractor needs a Dict with an entry for each node, as NodeObservation makes it, got {space}."
        )
    if missing := [name for name in graph.nodes if name not in space.spaces]:
        raise ConfigError(
            f"The observation has no node {', '.join(missing)} of the graph; it has {', '.join(space.spaces)}."
        )
    shapes = {name: space[name].shape for name in graph.nodes}
    first = shapes[graph.nodes[0]]
    if first is None or len(first) != 1 or set(shapes.values()) != {first}:
        listed = ", ".join(f"{name} {list(shape or ())}" for name, shape in shapes.items())
        raise ConfigError(f"The observations of all nodes must be vectors of one length, got {listed}.")
    return first[0]
