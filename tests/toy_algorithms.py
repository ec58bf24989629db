"""Build algorithms on a graph small enough to learn on in seconds, and batches of its task."""

import torch
from tensordict import TensorDict

from gctd3.algorithms.base import Architecture
from gctd3.algorithms.settings import DDPGSettings, SACSettings, TD3Settings
from gctd3.nn import Network
from gctd3.robots.graph import KinematicGraph

KINDS = {"td3": TD3Settings, "ddpg": DDPGSettings, "sac": SACSettings}
GCN, MLP = Network((16,), (32, 32), "none"), Network((), (32, 32), "none")
# A graph small enough to learn on in seconds: three nodes, two features, one action.
GRAPH = KinematicGraph.from_edges(["left", "middle", "right"], [("left", "middle"), ("middle", "right")])
PRIVILEGED = 2


def build(name, network=GCN, privileged_dim=PRIVILEGED, architecture=Architecture, seed=0, **settings):
    torch.manual_seed(seed)
    return KINDS[name](**settings).build(architecture(GRAPH, network, 2, 1, privileged_dim))


def goal(nodes):
    """Return the best action, which depends on both outer nodes."""
    return 0.8 * torch.tanh(nodes[..., 0, :1] - nodes[..., 2, :1])


def batch(size=64):
    """Make one-step episodes whose reward is minus the squared distance from the best action."""
    nodes, action = torch.randn(size, 3, 2), 2 * torch.rand(size, 1) - 1
    end = torch.ones(size, 1, dtype=torch.bool)
    following = {"nodes": torch.randn(size, 3, 2), "counters": torch.randn(size, PRIVILEGED)}
    following |= {"reward": -(action - goal(nodes)).pow(2), "terminated": end, "done": end.clone()}
    counters = torch.randn(size, PRIVILEGED)
    return TensorDict({"nodes": nodes, "counters": counters, "action": action, "next": following}, [size])


def going_on(size=64):
    """Make a batch in which no episode ends."""
    data = batch(size)
    for key in ("terminated", "done"):
        data["next", key].zero_()
    return data
