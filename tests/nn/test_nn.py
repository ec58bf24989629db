"""Graph convolutions against a second implementation, the sizes of Table 4, and stacks of networks."""

import copy
import itertools

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torch_geometric.nn import DenseGCNConv, GCNConv
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.objectives import SoftUpdate

from gctd3 import KinematicGraph, make_actor, make_critic, make_stochastic_actor
from gctd3.errors import ConfigError
from gctd3.nn import Actor, Critic, FlatEncoder, GraphConv, GraphEncoder, Network
from gctd3.nn.layers import LayerNorm, Linear
from gctd3.objectives import TD3Loss

NETWORKS = {
    "gcn": Network(norm="none"),
    "gcn, norm": Network(norm="layer"),
    "mlp": Network(graph_layers=(), norm="none"),
    "mlp, norm": Network(graph_layers=(), norm="layer"),
}


@pytest.fixture(params=NETWORKS)
def network(request) -> Network:
    return NETWORKS[request.param]


def random_graph(seed: int, num_nodes: int = 9) -> KinematicGraph:
    upper = np.triu(np.random.default_rng(seed).random((num_nodes, num_nodes)) < 0.3, k=1).astype(float)
    return KinematicGraph(tuple(f"n{i}" for i in range(num_nodes)), upper + upper.T)


def linears(module: nn.Module) -> list[tuple[int, int]]:
    return [(layer.in_features, layer.out_features) for layer in module.modules() if isinstance(layer, nn.Linear)]


# Graph convolution.


@pytest.mark.parametrize("bias", [True, False])
@pytest.mark.parametrize("seed", range(4))
def test_agrees_with_torch_geometric(seed, bias):
    graph = random_graph(seed)
    ours = GraphConv(10, 4, graph.normalized_adjacency, bias=bias)
    sparse, dense = GCNConv(10, 4, bias=bias), DenseGCNConv(10, 4, bias=bias)
    with torch.no_grad():
        if bias:
            nn.init.normal_(ours.bias)
        for theirs in (sparse, dense):
            theirs.lin.weight.copy_(ours.weight.T)
            if bias:
                theirs.bias.copy_(ours.bias)
    x = torch.randn(3, 9, 10)
    y = ours(x)
    edges = torch.from_numpy(np.argwhere(graph.adjacency).T)
    assert edges.shape[1] > 0
    torch.testing.assert_close(y, torch.stack([sparse(one, edges) for one in x]), atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(y, dense(x, torch.from_numpy(graph.adjacency).float()), atol=1e-5, rtol=1e-5)


def test_three_nodes_by_hand():
    # a -- b   c: P = [[1/2, 1/2, 0], [1/2, 1/2, 0], [0, 0, 1]], X = (2, 4, 6), Theta = 10, b = 1.
    graph = KinematicGraph.from_edges(("a", "b", "c"), [("a", "b")])
    layer = GraphConv(1, 1, graph.normalized_adjacency)
    with torch.no_grad():
        layer.weight.fill_(10.0)
        layer.bias.fill_(1.0)
    assert layer(torch.tensor([[2.0], [4.0], [6.0]])).tolist() == [[31.0], [31.0], [61.0]]
    # Of a directed graph: P[a, b] = 1 and nothing else, so a takes in b, and b nothing.
    layer.propagation.zero_()[0, 1] = 1.0
    assert layer(torch.tensor([[2.0], [4.0], [6.0]])).tolist() == [[41.0], [1.0], [1.0]]


def test_permuting_the_nodes_permutes_the_output():
    graph, order = random_graph(0), np.random.default_rng(1).permutation(9)
    assert not np.array_equal(graph.adjacency[np.ix_(order, order)], graph.adjacency)
    plain = GraphConv(5, 3, graph.normalized_adjacency)
    permuted = GraphConv(5, 3, graph.normalized_adjacency[np.ix_(order, order)])
    permuted.load_state_dict({**plain.state_dict(), "propagation": permuted.propagation})
    x = torch.randn(2, 9, 5)
    torch.testing.assert_close(permuted(x[:, order]), plain(x)[:, order])


@pytest.mark.parametrize("leading", [(), (4,), (2, 3), (0,)])
def test_leading_dimensions(graph, leading):
    layer, encoder, flat = GraphConv(10, 6, graph.normalized_adjacency), GraphEncoder(graph, 10), FlatEncoder(graph, 10)
    x = torch.randn(*leading, 8, 10)
    assert layer(x).shape == (*leading, 8, 6)
    assert encoder(x).shape == (*leading, encoder.out_features) == (*leading, 8 * 16)
    assert flat(x).shape == (*leading, flat.out_features) == (*leading, 8 * 10)
    for index in itertools.product(*map(range, leading)):
        torch.testing.assert_close(layer(x)[index], layer(x[index]))
        torch.testing.assert_close(encoder(x)[index], encoder(x[index]))


def test_encoder_puts_the_nodes_side_by_side_in_their_order(graph):
    encoder = GraphEncoder(graph, 10, (16,))
    x = torch.randn(2, 8, 10)
    torch.testing.assert_close(encoder(x).reshape(2, 8, 16), encoder.layers[0](x).relu())
    torch.testing.assert_close(FlatEncoder(graph, 10)(x)[:, 10:20], x[:, 1])


def test_wrong_input_shape_names_both_shapes(graph):
    layer = GraphConv(10, 32, graph.normalized_adjacency)
    with pytest.raises(ValueError, match=r"\[\*, 8, 10\], got \[4, 10, 8\]"):
        layer(torch.zeros(4, 10, 8))
    with pytest.raises(ValueError, match=r"\[N, N\], got \[8, 7\]"):
        GraphConv(10, 32, np.zeros((8, 7)))


# The networks of Table 4.


def test_sizes_of_table_4(graph):
    for module, head in (
        (Actor(Network(), graph, 10, 6), [(8 * 16, 256), (256, 256), (256, 6)]),
        # The action joins after the flatten.
        (Critic(Network(), graph, 10, 6), [(8 * 16 + 6, 256), (256, 256), (256, 1)]),
        (Critic(Network(), graph, 10, 6, privileged_dim=4), [(8 * 16 + 6 + 4, 256), (256, 256), (256, 1)]),
    ):
        convolutions = [layer for layer in module.modules() if isinstance(layer, GraphConv)]
        assert [(layer.in_features, layer.out_features) for layer in convolutions] == [(10, 32), (32, 32), (32, 16)]
        assert linears(module) == head
        # 10 x 32 + 32, 32 x 32 + 32, 32 x 16 + 16: the number of weights does not grow with the nodes.
        assert sum(p.numel() for layer in convolutions for p in layer.parameters()) == 352 + 1056 + 528


def test_mlp_sees_the_same_input_and_norm_stands_before_each_relu(graph):
    network = Network(graph_layers=(), norm="layer")
    assert linears(Actor(network, graph, 10, 6)) == [(8 * 10, 256), (256, 256), (256, 6)]
    kinds = [type(layer) for layer in Critic(network, graph, 10, 6).head]
    assert kinds == [Linear, LayerNorm, nn.ReLU, Linear, LayerNorm, nn.ReLU, Linear]


def test_gradients_reach_every_parameter(graph, network):
    actor, critic = Actor(network, graph, 10, 6), Critic(network, graph, 10, 6)
    nodes = torch.randn(32, 8, 10)
    critic(nodes, actor(nodes)).sum().backward()
    for parameter in (*actor.parameters(), *critic.parameters()):
        assert parameter.grad is not None and parameter.grad.abs().sum() > 0


def test_actor_module(graph, network):
    actor = make_actor(graph, 10, 6, network)
    assert actor.in_keys == ["nodes"] and actor.out_keys == ["action"]
    for leading in ((), (5,), (2, 3)):
        action = actor(TensorDict({"nodes": 100 * torch.randn(*leading, 8, 10)}, leading))["action"]
        assert action.shape == (*leading, 6) and action.abs().max() <= 1.0
        assert action.std() > 0


def test_critic_module(graph, network):
    critic = make_critic(graph, 10, 6, network, privileged_dim=4)
    assert critic.in_keys == ["nodes", "action", "counters"] and critic.out_keys == ["state_action_value"]
    assert make_critic(graph, 10, 6, network).in_keys == ["nodes", "action"]
    batch = TensorDict({"nodes": torch.randn(5, 8, 10), "action": torch.rand(5, 6), "counters": torch.rand(5, 4)}, [5])
    value = critic(batch.clone())["state_action_value"]
    assert value.shape == (5, 1)
    for key in critic.in_keys:
        other = batch.clone()
        other[key] = other[key] + 0.5
        assert (critic(other)["state_action_value"] != value).all(), f"{key} does not matter"


def test_stochastic_actor(graph, network):
    actor = make_stochastic_actor(graph, 10, 6, network)
    assert actor.in_keys == ["nodes"] and {"loc", "scale", "action"} <= set(actor.out_keys)
    batch = TensorDict({"nodes": torch.randn(5, 8, 10)}, [5])
    with set_exploration_type(ExplorationType.RANDOM):
        one, two = actor(batch.clone()), actor(batch.clone())
    assert one["loc"].shape == one["scale"].shape == one["action"].shape == (5, 6)
    assert one["action"].abs().max() <= 1.0 and (one["scale"] >= 0.01).all()
    assert not torch.equal(one["action"], two["action"]) and torch.equal(one["loc"], two["loc"])
    assert actor.get_dist(batch.clone()).log_prob(one["action"]).shape == (5,)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        torch.testing.assert_close(actor(batch.clone())["action"], one["loc"].tanh())


@pytest.mark.parametrize("scale", ["softplus", "exp"])
def test_scale_of_a_stochastic_actor(graph, scale):
    actor = make_stochastic_actor(graph, 10, 6, scale=scale)
    last = actor.module[0].module[0].head[-1]
    torch.nn.init.zeros_(last.weight)

    def scales(*values):
        """Return the scales of actions whose unbounded numbers are ``values``."""
        with torch.no_grad():
            last.bias[6:] = torch.tensor(values)
        return actor(TensorDict({"nodes": torch.randn(1, 8, 10)}, [1]))["scale"][0].tolist()

    # 0.01 + log(1 + exp(x + log(exp(0.99) - 1))), which is 1 at 0; exp of -20 at least, of 2 at most.
    expected = {"softplus": [1.0, 0.4938, 1.7323, 0.01, 5.5394], "exp": [1.0, 0.3679, 2.7183, 0.0, 7.3891]}
    assert scales(0.0, -1.0, 1.0, -50.0, 5.0, 0.0)[:5] == pytest.approx(expected[scale], abs=1e-4)


def test_a_scale_that_is_unknown(graph):
    with pytest.raises(ConfigError, match=r"^scale must be one of softplus, exp, got 'log'"):
        make_stochastic_actor(graph, scale="log")


def test_same_seed_same_network(graph, network):
    pair = []
    for _ in range(2):
        torch.manual_seed(3)
        pair.append(make_critic(graph, 10, 6, network).state_dict())
    for name, value in pair[0].items():
        assert torch.equal(value, pair[1][name])


@pytest.mark.parametrize("sizes", [{"graph_layers": (32, 0)}, {"hidden": (-1,)}, {"hidden": ()}])
def test_bad_sizes(sizes):
    with pytest.raises(ConfigError, match=rf"^{next(iter(sizes))} must"):
        Network(**sizes)


# Stacks.


def randomised(module: nn.Module) -> nn.Module:
    """Move biases and norms away from their zeros and ones, where a mistake with them would not show."""
    with torch.no_grad():
        for parameter in module.parameters():
            parameter.add_(0.3 * torch.randn_like(parameter))
    return module


@pytest.mark.parametrize("privileged", [0, 4])
def test_a_stack_of_two_critics_runs_as_each_one_does(graph, network, privileged):
    critics = [randomised(Critic(network, graph, 10, 6, privileged)) for _ in range(2)]
    inputs = [torch.randn(7, 8, 10), torch.rand(7, 6), *([torch.rand(7, privileged)] if privileged else [])]
    apart = torch.stack([critic(*inputs) for critic in critics])
    stack, together = TensorDict.from_modules(*critics), copy.deepcopy(critics[0])
    with stack.to_module(together):
        values = together(*inputs)
    assert values.shape == (2, 7, 1) and not torch.allclose(values[0], values[1])
    torch.testing.assert_close(values, apart, atol=1e-5, rtol=1e-5)


def test_critics_given_as_a_list_keep_their_initial_weights(graph):
    critics = [make_critic(graph) for _ in range(2)]
    initial = [copy.deepcopy(critic.state_dict()) for critic in critics]
    loss = TD3Loss(make_actor(graph), critics, bounds=(-1.0, 1.0))
    SoftUpdate(loss, tau=0.001)  # TorchRL warns of target parameters that nothing updates
    for params in (loss.qvalue_network_params, loss.target_qvalue_network_params):
        flat = params.data.flatten_keys(".")
        for name, value in initial[0].items():
            if "propagation" not in name:
                assert torch.equal(flat[name][0], value) and torch.equal(flat[name][1], initial[1][name])
    weight = "module.head.0.weight"
    assert not torch.equal(initial[0][weight], initial[1][weight])
