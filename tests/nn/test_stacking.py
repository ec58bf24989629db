"""Networks are recognised as stackable only if declared, and declared ones do take stacked parameters."""

import copy

import numpy as np
import pytest
import torch
from networks import NETWORKS, SIZES, randomised
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn

from gctd3.nn import Critic, GraphConv, Network, make_actor, make_critic
from gctd3.nn.layers import Linear
from gctd3.nn.stacking import obstacles
from gctd3.tasks.feature_table import FeatureTable
from gctd3.tasks.features import paper_features
from gctd3.tasks.reflection import Reflection


@pytest.mark.parametrize("batch", [(5,), (2,), (4, 8), (2, 2), ()], ids=str)
@pytest.mark.parametrize("name", NETWORKS)
def test_a_stack_of_every_network_gives_what_each_gives_alone(robot, graph, name, batch):
    table, feet = FeatureTable(paper_features(), robot, graph), (np.array([1, 0]), np.ones(2))
    reflection, (features, actions) = Reflection.of(robot, table, [feet, feet], static=2), SIZES
    critics = [
        randomised(make_critic(graph, features, actions, NETWORKS[name], 4, reflection)).double() for _ in range(2)
    ]
    assert obstacles(critics[0]) == []
    stack = copy.deepcopy(critics[0])
    TensorDict.from_modules(*critics).to_module(stack)
    inputs = [torch.randn(*batch, *shape).double() for shape in ((8, features), (actions,), (4,))]
    together = stack.module(*inputs)
    assert together.shape == (2, *batch, 1)
    alone = torch.stack([critic.module(*inputs) for critic in critics])
    assert not torch.allclose(alone[0], alone[1])
    torch.testing.assert_close(together, alone)


def test_a_stack_of_graph_convolutions_one_after_another(graph):
    layers = [GraphConv(3, 4, graph.normalized_adjacency), GraphConv(4, 5, graph.normalized_adjacency)]
    both = [nn.Sequential(*copy.deepcopy(layers)) for _ in range(2)]
    for one in both:
        randomised(one)
    stack, nodes = copy.deepcopy(both[0]), torch.randn(7, 8, 3)
    TensorDict.from_modules(*both).to_module(stack)
    torch.testing.assert_close(stack(nodes), torch.stack([one(nodes) for one in both]))


def test_our_networks_have_no_obstacle(graph):
    assert obstacles(make_critic(graph)) == [] == obstacles(make_actor(graph))


def wrapped(critic):
    return TensorDictModule(critic, ["nodes", "action"], ["state_action_value"])


def test_one_unknown_module_anywhere_is_an_obstacle(graph):
    assert obstacles(make_critic(graph)) == []
    plain = make_critic(graph)
    plain.module.head[0] = nn.Linear(plain.module.head[0].in_features, 256)
    assert obstacles(plain) == ["not declared to take stacked parameters: torch's Linear"]
    random = make_critic(graph)
    random.module.head[1] = nn.Dropout()
    assert "Dropout" in obstacles(random)[0]

    class Subclass(Critic):
        pass

    assert "Subclass" in obstacles(wrapped(Subclass(Network(), graph, 10, 6)))[0]
    hooked = make_critic(graph)
    hooked.module.head[0].register_forward_hook(lambda *_: None)
    assert "Linear" in obstacles(hooked)[0]
    patched = make_critic(graph)
    patched.module.encoder.forward = lambda nodes: nodes.flatten(-2)
    assert "GraphEncoder" in obstacles(patched)[0]
    # A layer does not say where a batch ends; only a network does.
    assert "whole network" in obstacles(TensorDictModule(Linear(3, 1), ["x"], ["state_action_value"]))[0]
