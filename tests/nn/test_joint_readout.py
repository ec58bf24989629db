"""The readout that all joints share: its weights fit every robot, whatever the order of its nodes."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from networks import NETWORKS, SIZES, randomised
from tensordict import TensorDict

from gctd3 import KinematicGraph, make_actor, make_stochastic_actor
from gctd3.errors import ConfigError, RobotError
from gctd3.nn import Actor, Critic, Network

FOUR_LEGS = [f"{part}_{leg}" for leg in "abcd" for part in ("hip", "knee")]


def four_legs():
    """Make a graph of ten nodes with eight actions."""
    edges = [("body", f"hip_{leg}") for leg in "abcd"] + [(f"hip_{leg}", f"knee_{leg}") for leg in "abcd"]
    edges += [(f"knee_{leg}", "ground") for leg in "abcd"]
    return KinematicGraph.from_edges(["body", *FOUR_LEGS, "ground"], edges, actuated=FOUR_LEGS)


def permuted(graph, order):
    """Return the same graph with its nodes in another order."""
    place = {node: i for i, node in enumerate(order)}
    return KinematicGraph(
        tuple(graph.nodes[i] for i in order),
        graph.adjacency[np.ix_(order, order)],
        actuated=tuple(place[i] for i in graph.actuated),
    )


JOINT = [name for name, network in NETWORKS.items() if network.readout == "joint"]


@pytest.mark.parametrize("name", JOINT)
def test_weights_of_one_robot_load_on_another(graph, name):
    network, other = replace(NETWORKS[name], equivariant=False), four_legs()
    for kind, inputs in ((Actor, 1), (Critic, 2)):
        here, there = randomised(kind(network, graph, *SIZES)), kind(network, other, 10, 8)
        there.load_state_dict(here.state_dict())  # strictly: nothing missing, nothing left
        assert len(here.state_dict()) == len(list(here.parameters()))
        out = there(*[torch.randn(5, 10, 10), torch.rand(5, 8)][:inputs])
        assert out.shape == (5, 8 if kind is Actor else 1) and torch.isfinite(out).all()
    stochastic = make_stochastic_actor(other, 10, 8, network)
    stochastic.load_state_dict(make_stochastic_actor(graph, *SIZES, network).state_dict())
    assert stochastic(TensorDict({"nodes": torch.randn(5, 10, 10)}, [5]))["scale"].shape == (5, 8)


@pytest.mark.parametrize("name", JOINT)
def test_the_order_of_nodes_and_actions_does_not_matter(name):
    network, graph = replace(NETWORKS[name], equivariant=False), four_legs()
    rng = np.random.default_rng(0)
    order, actions = rng.permutation(10), rng.permutation(8)
    other = permuted(graph, order)
    shuffled = KinematicGraph(other.nodes, other.adjacency, actuated=tuple(other.actuated[i] for i in actions))
    actor, critic = randomised(Actor(network, graph, 10, 8)), randomised(Critic(network, graph, 10, 8))
    nodes, action = torch.randn(5, 10, 10), torch.rand(5, 8)
    for here, inputs, inputs_there, take in (
        (actor, [nodes], [nodes[:, order]], actions),
        (critic, [nodes, action], [nodes[:, order], action[:, actions]], [0]),
    ):
        there = type(here)(network, shuffled, 10, 8)
        there.load_state_dict(here.state_dict())
        torch.testing.assert_close(there(*inputs_there), here(*inputs)[:, take], atol=1e-5, rtol=1e-5)
    assert not torch.allclose(critic(nodes, action), critic(nodes, action[:, actions]), atol=1e-4)


def test_equal_legs_in_equal_states_act_equally():
    graph = four_legs()
    actor = randomised(Actor(Network(readout="joint"), graph, 10, 8))
    hip, knee, rest = torch.randn(3, 10), torch.randn(3, 10), torch.randn(3, 2, 10)
    nodes = torch.stack([rest[:, 0], *[hip, knee] * 4, rest[:, 1]], dim=1)
    action = actor(nodes).reshape(3, 4, 2)
    torch.testing.assert_close(action, action[:, :1].expand(3, 4, 2))
    assert not torch.allclose(action[..., 0], action[..., 1], atol=1e-4)


def test_a_pool_by_hand():
    # Two nodes, of which the second moves; at each relu(x + 10 a + 1), their mean, a counter added, times 2.
    graph = KinematicGraph.from_edges(["a", "b"], [], actuated=["b"])
    critic = Critic(Network((), (1,), "none", readout="joint"), graph, 1, 1, 1)
    with torch.no_grad():
        for parameter in critic.parameters():
            parameter.zero_()
        critic.head.each[0].weight.copy_(torch.tensor([[1.0, 10.0]]))
        critic.head.each[0].bias.fill_(1.0)
        critic.head.pooled[0].weight.fill_(2.0)
    value = critic(torch.tensor([[[3.0], [5.0]]]), torch.tensor([[0.5]]), torch.tensor([[7.0]]))
    assert value.tolist() == [[2.0 * ((3 + 1 + 5 + 5 + 1) / 2 + 7.0)]]


def test_actions_must_have_their_nodes(robot, graph):
    assert [graph.nodes[i] for i in graph.actuated] == list(robot.actuated)
    network = Network(readout="joint")
    nameless = KinematicGraph(graph.nodes, graph.adjacency)
    for one, actions in ((nameless, 6), (graph, 5)):
        with pytest.raises(ConfigError, match=rf"node that each of the {actions} actions moves; the graph names"):
            make_actor(one, 10, actions, network)
    with pytest.raises(RobotError, match="No node c for an action: the nodes are a, b"):
        KinematicGraph.from_edges(["a", "b"], [], actuated=["c"])
