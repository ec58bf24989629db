"""The batched SAC loss equals TorchRL's, which runs its critics through vmap."""

import copy

import pytest
import torch
from tensordict import TensorDict
from torchrl.objectives import SACLoss as StockSACLoss
from torchrl.objectives import SoftUpdate

from gctd3.nn import Network, make_critic, make_stochastic_actor
from gctd3.objectives import SACLoss

BATCH = 32


def batch(counters):
    torch.manual_seed(1)
    done = torch.rand(BATCH, 1) < 0.3

    def state():
        extra = {"counters": torch.randn(BATCH, counters)} if counters else {}
        return {"nodes": torch.randn(BATCH, 8, 10), **extra}

    following = {**state(), "reward": torch.randn(BATCH, 1), "done": done, "terminated": done}
    action = torch.rand(BATCH, 6) * 1.8 - 0.9
    return TensorDict({**state(), "action": action, "next": TensorDict(following, [BATCH])}, [BATCH])


def losses_and_gradients(kind, actor, critics, data):
    # Copies, so that neither loss can see the other's gradients.
    loss = kind(copy.deepcopy(actor), copy.deepcopy(critics), loss_function="l2", target_entropy=-6.0)
    loss.make_value_estimator(gamma=0.99)
    SoftUpdate(loss, tau=0.005)
    torch.manual_seed(2)
    out = loss(data.clone())
    (out["loss_qvalue"] + out["loss_actor"] + out["loss_alpha"]).backward()
    gradients = {name: p.grad for name, p in loss.named_parameters() if p.grad is not None}
    return out, gradients


@pytest.mark.parametrize("network", [Network(norm="none"), Network(graph_layers=(), norm="layer")])
@pytest.mark.parametrize("counters", [0, 4])
def test_equal_to_torchrl(graph, network, counters):
    torch.manual_seed(0)
    actor = make_stochastic_actor(graph, network=network)
    critics = [make_critic(graph, network=network, privileged_dim=counters) for _ in range(2)]
    data = batch(counters)
    ours, our_gradients = losses_and_gradients(SACLoss, actor, critics, data)
    theirs, their_gradients = losses_and_gradients(StockSACLoss, actor, critics, data)
    for key in ("loss_qvalue", "loss_actor", "loss_alpha", "entropy"):
        torch.testing.assert_close(ours[key], theirs[key], rtol=1e-5, atol=1e-5)
    assert our_gradients.keys() == their_gradients.keys()
    assert all(gradient.abs().sum() > 0 for gradient in their_gradients.values())
    for name, gradient in their_gradients.items():
        torch.testing.assert_close(our_gradients[name], gradient, rtol=1e-4, atol=1e-5)
