"""What can be chosen of the graph network: each option against hand arithmetic, a second implementation or a property,
all of them as stacks of critics, under TorchRL's own loss, and in a training."""

import copy
import itertools
import warnings
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
import torch
from hydra import compose, initialize_config_module
from robots import opposite_axes
from running import rows, train
from tensordict import TensorDict
from test_td3_loss import batch, build, move_targets, run
from torch import nn
from torch.nn import functional
from torchrl.objectives import TD3Loss as TorchRLTD3Loss

from gctd3 import KinematicGraph, Robot, load_policy, make_actor, make_critic, make_stochastic_actor
from gctd3.envs.gait import FEATURES
from gctd3.errors import ConfigError, RobotError
from gctd3.nn import Actor, ChebyshevConv, Critic, GraphEncoder, Network
from gctd3.objectives import TD3Loss
from gctd3.reflection import Reflection, SignedPermutation
from gctd3.replay import Mirror
from gctd3.settings import build as build_settings

with warnings.catch_warnings():  # PyG scripts a class while it is imported
    warnings.filterwarnings("ignore", message=".*torch.jit.*", category=DeprecationWarning)
    from torch_geometric.nn import ChebConv

NETWORKS = {
    "graph norm": Network(graph_norm="layer"),
    "residual": Network(residual=True),
    "chebyshev": Network(chebyshev=2),
    "local and global": Network((32, 32, 16), residual=True, graph_norm="layer", mixing="alternating"),
    "joint": Network(readout="joint", norm="layer"),
    "joint without a graph": Network((), readout="joint", hidden=(32,)),
    "equivariant": Network(equivariant=True),
    "everything": Network(
        (16, 16), (32, 32), "layer", "layer", True, 2, mixing="alternating", readout="joint", equivariant=True
    ),
}
CHOICES = sorted({file.stem for file in (Path(str(files("gctd3.conf"))) / "network").glob("*.yaml")} - {"gcn", "mlp"})
SIZES = 10, 6  # features of a node over all frames, actions


@pytest.fixture(params=NETWORKS)
def network(request) -> Network:
    return NETWORKS[request.param]


@pytest.fixture(scope="module")
def reflection(robot) -> Reflection:
    return Reflection.from_robot(robot, FEATURES)


def randomised(module: nn.Module) -> nn.Module:
    """Biases and norms away from their zeros and ones, where a mistake with them would not show."""
    with torch.no_grad():
        for parameter in module.parameters():
            parameter.add_(0.05 * torch.randn_like(parameter))
    return module


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


# One head for all joints.

FOUR_LEGS = [f"{part}_{leg}" for leg in "abcd" for part in ("hip", "knee")]


def four_legs():
    """Ten nodes, eight actions."""
    edges = [("body", f"hip_{leg}") for leg in "abcd"] + [(f"hip_{leg}", f"knee_{leg}") for leg in "abcd"]
    edges += [(f"knee_{leg}", "ground") for leg in "abcd"]
    return KinematicGraph.from_edges(["body", *FOUR_LEGS, "ground"], edges, actuated=FOUR_LEGS)


def permuted(graph, order):
    """The same graph with its nodes in another order."""
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
    critic = Critic(Network((), (1,), readout="joint"), graph, 1, 1, 1)
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


# Left and right.


@pytest.fixture(scope="module", params=["equal axes", "opposite axes"])
def either(request, robot, tmp_path_factory):
    """The biped, and the biped whose mirrored joints turn the other way round."""
    return robot if request.param == "equal axes" else opposite_axes(robot, tmp_path_factory.mktemp("robot"))


@pytest.mark.parametrize("name", [name for name, network in NETWORKS.items() if network.equivariant])
@pytest.mark.parametrize("leading", [(), (7,), (2, 3)])
def test_acting_in_the_mirror_is_the_mirror_of_acting(either, name, leading):
    graph, mirror = KinematicGraph.from_robot(either), Mirror(either, 5)
    reflection = Reflection.from_robot(either, FEATURES)
    nodes, action = torch.randn(*leading, 8, 10), 2 * torch.rand(*leading, 6) - 1
    counters = torch.rand(*leading, 4)
    seen = {key: mirror.reflect(key, v) for key, v in (("nodes", nodes), ("action", action), ("counters", counters))}
    assert not torch.equal(seen["nodes"], nodes)
    network = NETWORKS[name]
    actor = randomised(Actor(network, graph, *SIZES, reflection=reflection))
    critic = randomised(Critic(network, graph, *SIZES, 4, reflection))
    exact = {"atol": 1e-6, "rtol": 1e-6}
    torch.testing.assert_close(actor(seen["nodes"]), mirror.reflect("action", actor(nodes)), **exact)
    value = critic(nodes, action, counters)
    assert value.shape == (*leading, 1)
    torch.testing.assert_close(critic(seen["nodes"], seen["action"], seen["counters"]), value, **exact)
    gaussian = randomised(make_stochastic_actor(graph, *SIZES, network, reflection))
    dist, mirrored = (gaussian.get_dist(TensorDict({"nodes": x}, leading)) for x in (nodes, seen["nodes"]))
    torch.testing.assert_close(mirrored.loc, mirror.reflect("action", dist.loc), **exact)
    torch.testing.assert_close(mirrored.scale, mirror.reflect("action", dist.scale).abs(), **exact)
    # And it is no trivial one: what is averaged is not equivariant by itself.
    plain = Actor(replace(network, equivariant=False), graph, *SIZES)
    plain.load_state_dict(actor.state_dict())
    with torch.no_grad():
        apart = (plain(seen["nodes"]) - mirror.reflect("action", plain(nodes))).abs().max()
    assert apart > 1e-3 and actor(nodes).std() > 0


def test_reflection_is_what_replay_mirrors(either):
    reflection, mirror = Reflection.from_robot(either, FEATURES), Mirror(either, 3)
    nodes = torch.randn(4, 8, 6)
    by_matrix = nodes.flatten(-2) @ torch.from_numpy(reflection.nodes(6).matrix).float()
    assert torch.equal(by_matrix.reshape(4, 8, 6), mirror.reflect("nodes", nodes))
    with pytest.raises(ValueError, match="2 features a frame cannot be 7"):
        reflection.nodes(7)
    with pytest.raises(RobotError, match="done twice"):
        SignedPermutation(np.array([1, 2, 0]), np.ones(3))


@pytest.mark.parametrize("task", ["walker", "humanoid", "quadruped"])
def test_reflection_of_robots_with_base_nodes_and_many_feet(task):
    from dm_control import suite  # not for the tests above

    model = suite.load(task, "walk").physics.model.ptr
    robot = Robot.from_mjcf(model)
    graph, matrix = KinematicGraph.from_robot(robot), Reflection.from_robot(robot).frame.matrix
    assert np.array_equal(matrix @ matrix, np.eye(2 * graph.num_nodes))
    values = np.random.default_rng(0).normal(size=(graph.num_nodes, 2))
    seen = (values.reshape(-1) @ matrix).reshape(values.shape)
    assert np.array_equal(seen[0], values[0])  # height and forward velocity
    for name, sign in (("pitch", 1.0), ("roll", -1.0), ("yaw", -1.0), ("side", -1.0)):
        rows = [i for i, node in enumerate(graph.nodes) if node == f"torso_{name}"]
        assert len(rows) == (name == "pitch" or task != "walker")
        assert np.array_equal(seen[rows], sign * values[rows])
    feet = [i for i, kind in enumerate(graph.kinds) if kind == "ground"]
    assert np.array_equal(seen[feet], values[feet, ::-1]) and len(feet) == (2 if task == "quadruped" else 1)


def test_an_equivariant_network_needs_a_reflection(graph, reflection):
    for make in (make_actor, make_critic, make_stochastic_actor):
        with pytest.raises(ConfigError, match=r"equivariant: true needs .*reflection=Reflection\.from_robot"):
            make(graph, *SIZES, Network(equivariant=True))
        with pytest.raises(ConfigError, match="reflection of all 5 actions, got one of 6"):
            make(graph, 10, 5, Network(equivariant=True), reflection=reflection)


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


def test_the_default_is_the_papers():
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        assert build_settings(compose("config", ["experiment=paper"])).network == Network()
        assert build_settings(compose("config")).network == Network(norm="layer")


@pytest.mark.parametrize("choice", CHOICES)
def test_trains(tmp_path, choice):
    run = train(tmp_path / "run", "algo=gctd3", f"network={choice}", "total_frames=120")
    assert int(rows(run)[-1]["updates"]) > 0 and len(CHOICES) >= 5
    action = load_policy(run)(TensorDict({"nodes": torch.randn(3, 8, 10)}, [3]))["action"]
    assert action.shape == (3, 6) and torch.isfinite(action).all()
