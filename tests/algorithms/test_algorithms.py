"""TD3, DDPG and SAC: each loss trains its own networks, targets move as in the paper, and each learns a toy problem."""

import copy
from dataclasses import dataclass

import pytest
import torch
from tensordict import TensorDict
from thinned import parametrize
from torch import nn
from torchrl.envs.utils import ExplorationType, set_exploration_type
from toy_algorithms import GCN, GRAPH, KINDS, MLP, PRIVILEGED, batch, build, goal, going_on

from gctd3.algorithms.base import Architecture, minimize
from gctd3.files import load_tree, save_tree
from gctd3.nn import make_actor, make_critic

every_algorithm = pytest.mark.parametrize("name", KINDS)


def groups(algorithm):
    """Return the parameters of each network under training, by the name of its optimiser."""
    loss = algorithm.loss
    critic = loss.qvalue_network_params if hasattr(loss, "qvalue_network") else loss.value_network_params
    found = {"actor": trainable(loss.actor_network_params), "critic": trainable(critic)}
    return found | ({"alpha": {"log_alpha": loss.log_alpha}} if hasattr(loss, "log_alpha") else {})


def trainable(params):
    return {key: value for key, value in params.flatten_keys(".").items() if value.requires_grad}


def values(params):
    """Copy parameters, so that training does not change them."""
    return {key: value.detach().clone() for key, value in sorted(params.flatten_keys(".").items())}


def same(a, b):
    return all(torch.equal(a[key], b[key]) for key in a)


def targets(algorithm):
    """Return pairs of parameters and their targets, by name."""
    loss, pairs = algorithm.loss, {}
    for net in ("actor_network", "value_network", "qvalue_network"):
        learnt, target = getattr(loss, f"{net}_params", None), getattr(loss, f"target_{net}_params", None)
        if learnt is not None and target is not None:
            pairs[net] = (learnt, target)
    pairs["actor_network"] = (loss.actor_network_params, algorithm.averaged_actor_params())
    return pairs


def act(policy, nodes):
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        return policy(TensorDict({"nodes": nodes}, [len(nodes)]))["action"]


# The networks that each loss trains.


def test_td3_clips_the_targets_actions_to_those_that_robots_take():
    """Critics of noisy target actions are asked for actions in [-1, 1] only (equation 9)."""
    algorithm, asked = build("td3"), []
    values_of = algorithm.loss._values

    def recording(name, inputs, params, action=None):
        asked.append((name, action))
        return values_of(name, inputs, params, action)

    algorithm.loss._values = recording
    algorithm.loss.policy_noise, algorithm.loss.noise_clip = 10.0, 10.0
    algorithm.loss.of_critics(batch())
    action = dict(asked)["target critics"]
    # With noise that large nearly all are at a bound.
    assert action.abs().max() == 1.0 and (action.abs() == 1.0).float().mean() > 0.5


def test_sac_lowers_the_temperature_of_a_policy_that_is_more_random_than_asked():
    """A new policy has more entropy than -1, the target for one action, and Adam's first step is the learning rate."""
    algorithm = build("sac")
    before = float(algorithm.loss.log_alpha.detach())
    algorithm.update(batch())
    rate = algorithm.settings.learning_rate
    assert float(algorithm.loss.log_alpha.detach()) - before == pytest.approx(-rate, rel=1e-3)


@every_algorithm
def test_a_step_of_one_optimiser_leaves_the_other_networks_alone(name):
    for stepped in groups(build(name)):
        algorithm = build(name)
        for _ in range(4):  # away from the initial weights
            algorithm.update(going_on())
        before = {group: {k: v.detach().clone() for k, v in ps.items()} for group, ps in groups(algorithm).items()}
        algorithm.loss.zero_grad(set_to_none=True)
        losses = algorithm.loss(going_on())
        term = {"critic": "loss_value" if name == "ddpg" else "loss_qvalue"}.get(stepped, f"loss_{stepped}")
        minimize(algorithm.optimizers[stepped], losses[term])
        for group, params in groups(algorithm).items():
            if group == stepped:
                assert all(p.grad is not None for p in params.values())
                assert not same(before[group], params)
            else:
                assert all(p.grad is None for p in params.values()), f"{term} reaches {group}"
                assert same(before[group], params)


def leaves(tensor):
    """Return the tensors for which a backward pass from ``tensor`` computes gradients."""
    seen, waiting, found = set(), [tensor.grad_fn], {}
    while waiting:
        node = waiting.pop()
        if node is None or node in seen:
            continue
        seen.add(node)
        waiting += [following for following, _ in node.next_functions]
        if hasattr(node, "variable"):
            found[node.variable.data_ptr()] = node.variable
    return found


@every_algorithm
def test_no_gradient_is_computed_that_nobody_reads(name):
    algorithm = build(name)
    losses = algorithm.loss(going_on())
    for stepped, params in groups(algorithm).items():
        term = {"critic": "loss_value" if name == "ddpg" else "loss_qvalue"}.get(stepped, f"loss_{stepped}")
        assert set(leaves(losses[term])) == {p.data_ptr() for p in params.values()}, term


@every_algorithm
def test_optimisers_hold_every_trainable_parameter_once_and_nothing_else(name):
    algorithm = build(name)
    held = [p for o in algorithm.optimizers.values() for group in o.param_groups for p in group["params"]]
    assert len({id(p) for p in held}) == len(held)
    assert {id(p) for p in held} == {id(p) for p in algorithm.loss.parameters() if p.requires_grad}
    assert not {id(p) for p in held} & {id(b) for b in algorithm.loss.buffers()}
    # Counted on fresh networks: SAC's actor has two outputs for an action, and a temperature beside it.
    actor = make_actor(GRAPH, 2, 2 if name == "sac" else 1, GCN)
    critic = make_critic(GRAPH, 2, 1, GCN, PRIVILEGED)
    size = [sum(p.numel() for p in module.parameters()) for module in (actor, critic)]
    expected = size[0] + (1 if name == "ddpg" else 2) * size[1] + (1 if name == "sac" else 0)
    assert sum(p.numel() for p in held) == expected


@every_algorithm
def test_the_critics_see_the_counters_and_the_policy_does_not(name):
    data = going_on()
    losses = []
    for here, there in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)):
        algorithm = build(name, gamma=0.9)
        changed = data.clone()
        changed["counters"] += here
        changed["next", "counters"] += there
        losses.append(float(algorithm.update(changed)["loss_critic"]))
        assert list(algorithm.policy().in_keys) == ["nodes"]
    assert len(set(losses)) == 3


# The critics' targets.


@dataclass(frozen=True)
class TwoEverywhere(Architecture):
    """Begin as critics with the value 2 everywhere."""

    def critic(self):
        critic = super().critic()
        last = critic.module.head[-1]
        nn.init.zeros_(last.weight)
        nn.init.constant_(last.bias, 2.0)
        return critic


@every_algorithm
def test_bootstrap_by_hand(name):
    # gamma 0.5, every value 2, every reward 1, no noise on the targets, an entropy of weight zero:
    #   one step, goes on        1 + 0.5   * 2 = 2     error 0
    #   two steps, goes on       1 + 0.5^2 * 2 = 1.5   error 0.5
    #   two steps, truncated     1 + 0.5^2 * 2 = 1.5   error 0.5
    #   three steps, terminated  1                     error 1
    # mean square (0 + 0.25 + 0.25 + 1) / 4 = 0.375 for each critic; SAC takes half of it.
    settings = {"td3": {"policy_noise": 0.0}, "sac": {"alpha": 1e-6}}.get(name, {})
    algorithm = build(name, architecture=TwoEverywhere, gamma=0.5, **settings)
    data = batch(4)
    data["next", "reward"] = torch.ones(4, 1)
    data["next", "terminated"] = torch.tensor([[False], [False], [False], [True]])
    data["next", "done"] = torch.tensor([[False], [False], [True], [True]])
    data["steps_to_next_obs"] = torch.tensor([1, 2, 2, 3])[:, None]
    loss = float(algorithm.update(data)["loss_critic"])
    assert loss == pytest.approx(2 * 0.375 if name == "td3" else 0.375, abs=1e-4)


# Times and sizes of the targets' updates.


@pytest.mark.parametrize(("name", "every"), [("td3", 1), ("td3", 2), ("td3", 3), ("ddpg", 1), ("sac", 1)])
def test_cadence_and_polyak_averages(name, every):
    tau = 0.25
    algorithm = build(name, tau=tau, learning_rate=1e-2, **({"policy_delay": every} if name == "td3" else {}))
    critic = "value_network" if name == "ddpg" else "qvalue_network"
    assert set(targets(algorithm)) == {"actor_network", critic}
    for learnt, target in targets(algorithm).values():
        assert same(values(target), values(learnt))  # they begin equal
    for update in range(1, 2 * every + 2):
        before = {net: (values(learnt), values(target)) for net, (learnt, target) in targets(algorithm).items()}
        algorithm.update(going_on())
        assert algorithm.updates == update
        due = update % every == 0
        for net, (learnt, target) in targets(algorithm).items():
            old_learnt, old_target = before[net]
            new_learnt, new_target = values(learnt), values(target)
            assert same(old_learnt, new_learnt) == (net == "actor_network" and not due)
            assert same(old_target, new_target) == (not due)
            if due:
                for key, old in old_target.items():
                    torch.testing.assert_close(new_target[key], tau * new_learnt[key] + (1 - tau) * old)


# The policy to ship.


@pytest.mark.parametrize("average", [False, True])
@every_algorithm
def test_policy_is_a_detached_copy(name, average):
    algorithm = build(name, average_policy=average, tau=0.1, learning_rate=1e-2)
    for _ in range(4):
        algorithm.update(batch())
    nodes, policy = torch.randn(5, 3, 2), algorithm.policy()
    shown = act(policy, nodes)

    learnt, averaged = targets(algorithm)["actor_network"]
    expected, actor = [], copy.deepcopy(algorithm.actor)
    for params in (learnt, averaged):
        params.data.clone().to_module(actor)
        expected.append(act(actor, nodes))
    torch.testing.assert_close(shown, expected[average])
    assert not torch.allclose(shown, expected[not average])

    assert not policy.training
    assert not any(p.requires_grad for p in policy.parameters())
    for _ in range(4):
        algorithm.update(batch())
    assert torch.equal(act(policy, nodes), shown), "training goes on in the policy"
    assert not torch.allclose(act(algorithm.policy(), nodes), shown)


# Resuming and repeating.


def train(algorithm, updates, seed):
    torch.manual_seed(seed)
    for _ in range(updates):
        algorithm.update(going_on())
    return algorithm


def assert_identical(a, b):
    def leaves(state, prefix=""):
        if isinstance(state, (dict, list, tuple)):
            items = state.items() if isinstance(state, dict) else enumerate(state)
            return {k: v for key, value in items for k, v in leaves(value, f"{prefix}.{key}").items()}
        return {prefix: state}

    a, b = leaves(a.state_dict()), leaves(b.state_dict())
    assert a.keys() == b.keys()
    for key, value in a.items():
        assert torch.equal(value, b[key]) if isinstance(value, torch.Tensor) else value == b[key], key


@pytest.mark.parametrize("where", ["memory", "disk"])
@every_algorithm
def test_a_restored_algorithm_continues_identically(name, where, tmp_path):
    first = train(build(name), 3, seed=1)  # after three updates TD3's actor is due next
    other = train(build(name, seed=7), 2, seed=8)
    if where == "memory":
        other.load_state_dict(copy.deepcopy(first.state_dict()))
    else:
        save_tree(tmp_path / "state.safetensors", first.state_dict())
        other.load_state_dict(load_tree(tmp_path / "state.safetensors"))
    assert_identical(first, other)
    nodes = torch.randn(5, 3, 2)
    assert torch.equal(act(first.actor, nodes), act(other.actor, nodes))
    assert torch.equal(act(first.policy(), nodes), act(other.policy(), nodes))
    assert_identical(train(first, 3, seed=2), train(other, 3, seed=2))
    assert torch.equal(act(first.policy(), nodes), act(other.policy(), nodes))


@every_algorithm
def test_same_seed_same_result(name):
    assert_identical(train(build(name), 4, seed=3), train(build(name), 4, seed=3))
    one, two = train(build(name), 4, seed=3), train(build(name), 4, seed=4)
    assert not same(values(one.loss.actor_network_params), values(two.loss.actor_network_params))


# Learning.


@parametrize(2, "network", [GCN, MLP], ids=["gcn", "mlp"])
@every_algorithm
def test_learns_a_toy_problem(name, network):
    settings = {"alpha": 0.05} if name == "sac" else {}
    algorithm = build(name, network, 0, learning_rate=3e-3, tau=0.05, **settings)
    nodes = batch(512)["nodes"]

    def error():
        return float((act(algorithm.policy(), nodes) - goal(nodes)).pow(2).mean())

    # The best action without the nodes is 0, with a mean squared error of 0.3; a fresh policy has about the same.
    assert error() > 0.25
    for _ in range(300):
        algorithm.update(batch())
    assert error() < 0.08
