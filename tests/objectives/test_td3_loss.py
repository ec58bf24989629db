"""TD3's loss has TorchRL's values and gradients, and its target equals hand arithmetic."""

import numpy as np
import pytest
import torch
from td3_losses import LEARNT, batch, build, move_targets, networks, run
from tensordict import TensorDict
from torchrl.objectives import TD3Loss as TorchRLTD3Loss

from gctd3 import KinematicGraph, make_actor, make_critic
from gctd3.nn import Network
from gctd3.objectives import TD3Loss

# Against TorchRL.


@pytest.mark.parametrize("norm", ["none", "layer"])
@pytest.mark.parametrize("graph_layers", [(32, 32, 16), ()], ids=["gcn", "mlp"])
def test_equals_torchrls_loss_and_gradients(graph, graph_layers, norm):
    actor, critics = networks(graph, graph_layers, norm)
    ours, theirs = (build(kind, actor, critics) for kind in (TD3Loss, TorchRLTD3Loss))
    data = batch()
    for loss in (ours, theirs):
        move_targets(loss)
    assert not {p.data_ptr() for p in ours.parameters()} & {p.data_ptr() for p in theirs.parameters()}
    for key in ("loss_actor", "loss_qvalue"):
        (mine, my_gradients), (other, other_gradients) = run(ours, data, key), run(theirs, data, key)
        for name in ("loss_actor", "loss_qvalue", "pred_value", "next_state_value", "target_value"):
            torch.testing.assert_close(mine[name], other[name], atol=1e-5, rtol=1e-5)
            assert mine[name].abs().max() > 1e-3
        # TorchRL evaluates every critic on the actor's action and uses the first.
        first = other["state_action_value_actor"][0]
        torch.testing.assert_close(mine["state_action_value_actor"], first, atol=1e-5, rtol=1e-5)
        assert my_gradients.keys() == other_gradients.keys() and len(my_gradients) > 10
        reached = {name for name, gradient in other_gradients.items() if gradient is not None}
        assert reached == {name for name, gradient in my_gradients.items() if gradient is not None}
        for name in reached:
            assert other_gradients[name].abs().max() > 0, name
            torch.testing.assert_close(my_gradients[name], other_gradients[name], atol=1e-5, rtol=1e-4)


def test_priorities_equal_torchrls(graph):
    actor, critics = networks(graph)
    data, priorities = batch(), []
    for kind in (TD3Loss, TorchRLTD3Loss):
        loss, written = build(kind, actor, critics), data.clone()
        torch.manual_seed(11)
        loss(written)
        priorities.append(written["td_error"])
    assert priorities[0].min() > 0
    torch.testing.assert_close(*priorities, atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("key, learns", [("loss_actor", LEARNT[0]), ("loss_qvalue", LEARNT[1])])
@pytest.mark.parametrize("graph_layers", [(32, 32, 16), ()], ids=["gcn", "mlp"])
def test_each_term_reaches_its_own_networks_only(graph, graph_layers, key, learns):
    loss = build(TD3Loss, *networks(graph, graph_layers))
    _, reached = run(loss, batch(), key)
    for name, gradient in reached.items():
        if name.startswith(learns):
            # Both critics, not only the first of the stack.
            assert all(one.abs().sum() > 0 for one in (gradient if learns == LEARNT[1] else [gradient])), name
        else:
            assert gradient is None or not gradient.any(), name
    for params in (loss.target_actor_network_params, loss.target_qvalue_network_params):
        assert not any(value.requires_grad for value in params.values(True, True))


def test_loss_leaves_the_batch_as_it_was(graph):
    loss, data = build(TD3Loss, *networks(graph, privileged_dim=4)), batch(4)
    kept = data.clone()
    loss(data)
    for key in kept.keys(True, True):
        torch.testing.assert_close(data[key], kept[key], rtol=0, atol=0)


# Critics that see more than the actor.


def test_privileged_critics(graph):
    actor, critics = networks(graph, privileged_dim=4)
    loss, data = build(TD3Loss, actor, critics), batch(4)
    assert {"counters", ("next", "counters"), ("next", "nodes")} <= set(loss.in_keys)
    assert "counters" not in actor.in_keys
    out, _ = run(loss, data, "loss_qvalue")
    assert torch.isfinite(out["loss_actor"]) and torch.isfinite(out["loss_qvalue"])
    for key, changed in ((("next", "counters"), "target_value"), ("counters", "pred_value")):
        other = data.clone()
        other[key] = other[key] + 1.0
        assert not torch.allclose(run(loss, other, "loss_qvalue")[0][changed], out[changed])


def test_privileged_target_by_the_networks_themselves(graph):
    actor, critics = networks(graph, privileged_dim=4)
    loss, data = build(TD3Loss, actor, critics, policy_noise=0.0), batch(4)
    following = actor(data["next"].clone())
    values = torch.stack([critic(following.clone())["state_action_value"].squeeze(-1) for critic in critics])
    bootstrap = 0.9 * values.min(0)[0] * ~data["next", "terminated"].squeeze(-1)
    target = data["next", "reward"].squeeze(-1) + bootstrap
    out, _ = run(loss, data, "loss_qvalue")
    torch.testing.assert_close(out["target_value"], target.detach(), atol=1e-5, rtol=1e-5)


# The target by hand (equation 9). One node, one feature s, one action a.
#
#   actor      a(s) = 0.5
#   critics    Q1(s, a) = s + 2 a,   Q2(s, a) = 3


def by_hand(**settings):
    graph = KinematicGraph(("point",), np.zeros((1, 1)))
    network = Network(graph_layers=(), hidden=(1,), norm="none")
    actor, *critics = make_actor(graph, 1, 1, network), *(make_critic(graph, 1, 1, network) for _ in range(2))
    with torch.no_grad():
        for module in (actor, *critics):
            for parameter in module.parameters():
                parameter.zero_()
        actor.module.head[-1].bias.fill_(np.arctanh(0.5))
        critics[0].module.head[0].weight.copy_(torch.tensor([[1.0, 2.0]]))
        critics[0].module.head[-1].weight.fill_(1.0)
        critics[1].module.head[-1].bias.fill_(3.0)
    return build(TD3Loss, actor, critics, **settings)


def transitions(**extra):
    """Return an ordinary transition, one that terminates and one that is truncated."""

    def column(*values):
        return torch.tensor(values).reshape(3, 1)

    following = {
        "nodes": column(1.0, 5.0, 4.0)[..., None],
        "reward": column(1.0, -10.0, 0.5),
        "done": column(False, True, True),
        "terminated": column(False, True, False),
        "truncated": column(False, False, True),
    }
    now = {"nodes": column(2.0, 3.0, 1.0)[..., None], "action": column(0.0, 1.0, -0.25)}
    return TensorDict({**now, **extra, "next": following}, [3])


def test_target_of_three_transitions_by_hand():
    out = by_hand(policy_noise=0.0)(transitions())
    # s'        1                5                4
    # Q1'       1 + 2 * 0.5 = 2  5 + 1 = 6        4 + 1 = 5
    # min(., 3) 2                3                3
    # target    1 + 0.9 * 2      -10, terminated  0.5 + 0.9 * 3, truncated
    torch.testing.assert_close(out["next_state_value"], torch.tensor([2.0, 3.0, 3.0]))
    torch.testing.assert_close(out["target_value"], torch.tensor([2.8, -10.0, 3.2]))
    # Q1(s, a)  2 + 2 * 0 = 2    3 + 2 * 1 = 5    1 - 2 * 0.25 = 0.5
    torch.testing.assert_close(out["pred_value"], torch.tensor([[2.0, 5.0, 0.5], [3.0, 3.0, 3.0]]))
    # Q1: 0.8^2 + 15^2 + 2.7^2 = 0.64 + 225 + 7.29 = 232.93; Q2: 0.2^2 + 13^2 + 0.2^2 = 169.08.
    assert out["loss_qvalue"].item() == pytest.approx((232.93 + 169.08) / 3)
    # -Q1(s, 0.5) = -(3 + 4 + 2) / 3
    assert out["loss_actor"].item() == pytest.approx(-3.0)


def test_n_step_target_by_hand():
    # Rewards are already sums over 3, 1 and 2 steps: the bootstrap is discounted by 0.9^n.
    data = transitions(steps_to_next_obs=torch.tensor([[3], [1], [2]]))
    out = by_hand(policy_noise=0.0)(data)
    # 1 + 0.729 * 2 = 2.458; -10, terminated; 0.5 + 0.81 * 3 = 2.93
    torch.testing.assert_close(out["target_value"], torch.tensor([2.458, -10.0, 2.93]))


@pytest.mark.parametrize(
    "clip, actions",
    [
        (0.5, (0.0, 1.0)),  # a' = 0.5 - 0.5 or 0.5 + 0.5
        (0.25, (0.25, 0.75)),
        (9.0, (-1.0, 1.0)),  # the bounds
    ],
)
def test_target_noise_is_clipped_and_the_action_kept_in_bounds(clip, actions):
    loss, seen = by_hand(policy_noise=1e6, noise_clip=clip), set()
    for seed in range(20):
        torch.manual_seed(seed)
        seen.add(round(loss(transitions())["next_state_value"][0].item(), 5))
    # s' = 1: min(1 + 2 a', 3), and Q1's ReLU keeps it at 0 or above
    assert seen == {max(1 + 2 * a, 0.0) for a in actions}
