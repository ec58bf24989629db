"""Options of the graph network: each equals hand arithmetic or a second implementation or has a property, and all work
as stacks of critics, under TorchRL's own loss, and in a training."""

import copy
import itertools
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
import torch
from compositions import walking
from hydra import compose, initialize_config_module
from networks import NETWORKS, SIZES, randomised
from running import rows, train
from td3_losses import batch, build, move_targets, run
from tensordict import TensorDict
from torch import nn
from torch.nn import functional
from torch_geometric.nn import ChebConv
from torchrl.objectives import TD3Loss as TorchRLTD3Loss

from gctd3 import KinematicGraph, load_policy, make_actor, make_critic
from gctd3.config.build import build as build_settings
from gctd3.errors import ConfigError
from gctd3.nn import Actor, ChebyshevConv, Critic, GraphEncoder, Network
from gctd3.objectives import TD3Loss
from gctd3.tasks.reflection import Reflection

CHOICES = sorted({file.stem for file in (Path(str(files("gctd3.conf"))) / "network").glob("*.yaml")} - {"gcn", "mlp"})


@pytest.fixture(params=NETWORKS)
def network(request) -> Network:
    return NETWORKS[request.param]


@pytest.fixture(scope="module")
def reflection(robot) -> Reflection:
    return walking(robot).reflection()


def random_graph(seed, num_nodes=9):
    upper = np.triu(np.random.default_rng(seed).random((num_nodes, num_nodes)) < 0.3, k=1).astype(float)
    return KinematicGraph(tuple(f"n{i}" for i in range(num_nodes)), upper + upper.T)


# Chebyshev layers.


@pytest.mark.parametrize("largest", [2.0, None])
@pytest.mark.parametrize("order", [0, 1, 2, 4])
@pytest.mark.parametrize("seed", range(2))
def test_chebyshev_agrees_with_torch_geometric(seed, order, largest):
    graph = random_graph(seed)
    ours = randomised(ChebyshevConv(10, 4, graph.chebyshev(order, largest)))
    theirs = ChebConv(10, 4, K=order + 1, normalization="sym")
    with torch.no_grad():
        for one, weight in zip(theirs.lins, ours.weight.split(10), strict=True):
            one.weight.copy_(weight.T)
        theirs.bias.copy_(ours.bias)
    edges = torch.from_numpy(np.argwhere(graph.adjacency).T)
    eigenvalue = torch.tensor(largest or np.linalg.eigvalsh(graph.laplacian).max(), dtype=torch.float32)
    x = torch.randn(3, 9, 10)
    expected = torch.stack([theirs(one, edges, lambda_max=eigenvalue) for one in x])
    torch.testing.assert_close(ours(x), expected, atol=1e-5, rtol=1e-5)


def test_chebyshev_reaches_as_many_edges_as_its_order(graph):
    layer = ChebyshevConv(1, 1, graph.chebyshev(2))
    x = torch.zeros(2, graph.num_nodes, 1)
    x[1, graph.nodes.index("hip_right")] = 1.0
    changed = {name for name, a, b in zip(graph.nodes, *layer(x).detach(), strict=True) if not torch.equal(a, b)}
    # body -- hip -- knee -- ankle and body -- hip_left: the ankle and the other hip are two edges away.
    assert changed == {"hip_right", "body", "hip_left", "knee_right", "ankle_right"}


def test_chebyshev_needs_polynomials():
    with pytest.raises(ValueError, match=r"\[K \+ 1, N, N\], got \[8, 8\]"):
        ChebyshevConv(10, 32, np.zeros((8, 8)))
    with pytest.raises(ValueError, match="need a KinematicGraph"):
        GraphEncoder(np.eye(8), 10, chebyshev=2)


# Norms, skips, layers over all nodes.


def test_a_layer_is_relu_of_norm_and_skip(graph):
    encoder = randomised(GraphEncoder(graph, 10, (16, 16), norm=True, residual=True))
    x, p = torch.randn(4, 8, 10), torch.from_numpy(graph.normalized_adjacency).float()
    y = x
    for i, (layer, norm) in enumerate(zip(encoder.layers, encoder.norms, strict=True)):
        convolved = p @ y @ layer.weight + layer.bias
        normal = functional.layer_norm(convolved, (16,), norm.weight, norm.bias)
        # Widths 10 and 16 differ: a linear map; 16 and 16 agree: nothing.
        skip = y @ encoder.skips[0].weight.T if i == 0 else y
        y = torch.relu(normal + skip)
    torch.testing.assert_close(encoder(x), y.flatten(-2), atol=1e-5, rtol=1e-5)
    assert encoder.skips[0].weight.shape == (16, 10) and not list(encoder.skips[1].parameters())


def test_every_second_layer_mixes_all_nodes(graph):
    encoder = GraphEncoder(graph, 10, (16, 16, 16), residual=True, mixing="alternating")
    local, everything = torch.from_numpy(graph.normalized_adjacency).float(), torch.full((8, 8), 1 / 8)
    for layer, expected in zip(encoder.layers, (local, everything, local), strict=True):
        torch.testing.assert_close(layer.propagation, expected)
    # A change at one node: after one layer seen by its neighbours, after two by all.
    assert encoder.layers[0].propagation[0].count_nonzero() == 3
    x = torch.randn(2, 8, 10)
    x[1, 1:] = x[0, 1:]
    a, b = encoder(x).reshape(2, 8, 16)
    assert (a != b).any(-1).all()
    from_matrix = GraphEncoder(local, 10, (16, 16), residual=True, mixing="alternating")
    torch.testing.assert_close(from_matrix.layers[1].propagation, everything)


@pytest.mark.parametrize(
    "settings, message",
    [
        ({"chebyshev": -1}, "chebyshev must be an order of at least 0 and at most 100, or null, got -1"),
        ({"mixing": "alternating"}, "mixing must be local unless residual is true"),
        ({"graph_layers": (), "residual": True}, "graph_layers must hold at least one size for residual"),
        ({"graph_layers": (), "graph_norm": "layer", "chebyshev": 2}, "for graph_norm, chebyshev to act on"),
    ],
)
def test_options_that_do_not_fit(settings, message):
    with pytest.raises(ConfigError, match=message):
        Network(**settings)


# All of them.


@pytest.mark.parametrize("privileged", [0, 4])
def test_a_stack_of_critics_runs_as_each_one_does(graph, reflection, network, privileged):
    critics = [randomised(Critic(network, graph, *SIZES, privileged, reflection)) for _ in range(3)]
    inputs = [torch.randn(7, 8, 10), torch.rand(7, 6), *([torch.rand(7, privileged)] if privileged else [])]
    apart = torch.stack([critic(*inputs) for critic in critics])
    stack, together = TensorDict.from_modules(*critics), copy.deepcopy(critics[0])
    with stack.to_module(together):
        values = together(*inputs)
    assert values.shape == (3, 7, 1) and not torch.allclose(values[0], values[1])
    torch.testing.assert_close(values, apart, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("leading", [(), (4,), (2, 3), (0,)])
def test_leading_dimensions(graph, reflection, network, leading):
    actor = randomised(Actor(network, graph, *SIZES, reflection=reflection))
    critic = randomised(Critic(network, graph, *SIZES, reflection=reflection))
    nodes, action = torch.randn(*leading, 8, 10), torch.rand(*leading, 6)
    acts, value = actor(nodes), critic(nodes, action)
    assert acts.shape == (*leading, 6) and value.shape == (*leading, 1)
    for index in itertools.product(*map(range, leading)):
        torch.testing.assert_close(actor(nodes[index]), acts[index], atol=1e-5, rtol=1e-5)
        torch.testing.assert_close(critic(nodes[index], action[index]), value[index], atol=1e-5, rtol=1e-5)


def test_gradients_reach_every_parameter(graph, reflection, network):
    actor = Actor(network, graph, *SIZES, reflection=reflection)
    critic = Critic(network, graph, *SIZES, 4, reflection)
    nodes = torch.randn(32, 8, 10)
    critic(nodes, actor(nodes), torch.rand(32, 4)).sum().backward()
    for parameter in (*actor.parameters(), *critic.parameters()):
        assert parameter.grad is not None and parameter.grad.abs().sum() > 0


def test_equals_torchrls_loss_and_gradients(graph, reflection, network):
    small = replace(network, hidden=(32, 32))
    actor = make_actor(graph, *SIZES, small, reflection)
    critics = [make_critic(graph, *SIZES, small, reflection=reflection) for _ in range(2)]
    for module in (actor, *critics):
        for parameter in module.parameters():
            nn.init.normal_(parameter, std=0.3)
    ours, theirs = (build(kind, actor, critics) for kind in (TD3Loss, TorchRLTD3Loss))
    data = batch()
    for loss in (ours, theirs):
        move_targets(loss)
    for key in ("loss_actor", "loss_qvalue"):
        (mine, my_gradients), (other, other_gradients) = run(ours, data, key), run(theirs, data, key)
        for name in ("loss_actor", "loss_qvalue", "pred_value", "target_value"):
            torch.testing.assert_close(mine[name], other[name], atol=1e-4, rtol=1e-4)
        reached = {name for name, gradient in other_gradients.items() if gradient is not None}
        assert reached == {name for name, gradient in my_gradients.items() if gradient is not None} and reached
        for name in reached:
            torch.testing.assert_close(my_gradients[name], other_gradients[name], atol=1e-4, rtol=1e-3)


def test_the_default_is_what_training_uses_and_the_papers_has_no_norm():
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        assert build_settings(compose("config")).network == Network()
        assert build_settings(compose("config", ["experiment=paper"])).network == Network(norm="none")


# A readout of another shape and weights that are tied; the others differ in their layers only.
QUICK = ("per_joint", "equivariant")


@pytest.mark.parametrize("choice", [pytest.param(c, marks=[pytest.mark.nightly] * (c not in QUICK)) for c in CHOICES])
def test_trains(tmp_path, choice):
    run = train(tmp_path / "run", "algo=gctd3", f"network={choice}", "total_frames=120")
    assert int(rows(run)[-1]["updates"]) > 0 and len(CHOICES) >= 5
    action = load_policy(run)(TensorDict({"nodes": torch.randn(3, 8, 10)}, [3]))["action"]
    assert action.shape == (3, 6) and torch.isfinite(action).all()
