"""Define networks of PyTorch's own layers without gctd3's, and algorithms for them."""

from dataclasses import dataclass

import torch
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import nn
from torchrl.data import Bounded
from torchrl.modules import ProbabilisticActor, TanhNormal

from gctd3.algorithms.base import Architecture
from gctd3.algorithms.settings import DDPGSettings, SACSettings, TD3Settings
from gctd3.nn import Network


def layers(inputs, outputs):
    return nn.Sequential(
        nn.Linear(inputs, 32), nn.LayerNorm(32), nn.ELU(), nn.Linear(32, 32), nn.ReLU(), nn.Linear(32, outputs)
    )


class PlainActor(nn.Module):
    def __init__(self, inputs, outputs, squash):
        super().__init__()
        self.layers, self.squash = layers(inputs, outputs), squash

    def forward(self, nodes):
        out = self.layers(nodes.flatten(-2))
        return torch.tanh(out) if self.squash else out


class PlainCritic(nn.Module):
    def __init__(self, inputs):
        super().__init__()
        self.layers = layers(inputs, 1)

    def forward(self, nodes, *beside):
        return self.layers(torch.cat([nodes.flatten(-2), *beside], -1))


@dataclass(frozen=True)
class PlainArchitecture(Architecture):
    @property
    def inputs(self):
        return self.graph.num_nodes * self.in_features

    def actor(self):
        return TensorDictModule(PlainActor(self.inputs, self.action_dim, True), ["nodes"], ["action"])

    def stochastic_actor(self, scale="softplus"):
        net = nn.Sequential(PlainActor(self.inputs, 2 * self.action_dim, False), NormalParamExtractor())
        return ProbabilisticActor(
            TensorDictModule(net, ["nodes"], ["loc", "scale"]),
            in_keys=["loc", "scale"],
            spec=Bounded(-1.0, 1.0, (self.action_dim,)),
            distribution_class=TanhNormal,
        )

    def critic(self):
        critic = PlainCritic(self.inputs + self.action_dim + self.privileged_dim)
        beside = ["counters"] if self.privileged_dim else []
        return TensorDictModule(critic, ["nodes", "action", *beside], ["state_action_value"])


class Plain:
    def build(self, architecture):
        return super().build(PlainArchitecture(**vars(architecture)))


@dataclass(frozen=True)
class PlainTD3(Plain, TD3Settings):
    pass


@dataclass(frozen=True)
class PlainSAC(Plain, SACSettings):
    pass


@dataclass(frozen=True)
class PlainDDPG(Plain, DDPGSettings):
    pass


@dataclass(frozen=True)
class PlainHead(Network):
    """Combine our encoders with fully connected layers of PyTorch."""

    def head(self, in_features, out_features):
        return layers(in_features, out_features)
