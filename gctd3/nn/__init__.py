"""Networks over a kinematic graph, as plain modules and as TensorDictModules."""

from gctd3.nn.actor import Actor, make_actor, make_stochastic_actor
from gctd3.nn.critic import Critic, make_critic
from gctd3.nn.encoder import FlatEncoder, GraphEncoder
from gctd3.nn.equivariance import Symmetric
from gctd3.nn.graph_conv import ChebyshevConv, GraphConv
from gctd3.nn.network import Network
from gctd3.nn.readout import JointReadout, PooledReadout

__all__ = [
    "Actor",
    "ChebyshevConv",
    "Critic",
    "FlatEncoder",
    "GraphConv",
    "GraphEncoder",
    "JointReadout",
    "Network",
    "PooledReadout",
    "Symmetric",
    "make_actor",
    "make_critic",
    "make_stochastic_actor",
]
