"""Networks over a kinematic graph, as plain modules and as TensorDictModules."""

from gctd3.nn.actor import Actor, make_actor, make_stochastic_actor
from gctd3.nn.critic import Critic, make_critic
from gctd3.nn.encoder import FlatEncoder, GraphEncoder
from gctd3.nn.graph_conv import GraphConv
from gctd3.nn.network import Network

__all__ = [
    "Actor",
    "Critic",
    "FlatEncoder",
    "GraphConv",
    "GraphEncoder",
    "Network",
    "make_actor",
    "make_critic",
    "make_stochastic_actor",
]
