"""Build TD3's loss and TorchRL's on the same networks, and compare what they give."""

import copy

import torch
from tensordict import TensorDict
from torch import nn
from torchrl.objectives import SoftUpdate, ValueEstimators

from gctd3 import make_actor, make_critic
from gctd3.nn import Network

BATCH = 16
LEARNT = ("actor_network_params", "qvalue_network_params")


def build(kind, actor, critics, gamma=0.9, **settings):
    loss = kind(copy.deepcopy(actor), copy.deepcopy(critics), bounds=(-1.0, 1.0), loss_function="l2", **settings)
    loss.make_value_estimator(ValueEstimators.TD0, gamma=gamma)
    SoftUpdate(loss, tau=0.001)  # TorchRL warns of target parameters that nothing updates
    return loss


def networks(graph, graph_layers=(32, 32, 16), norm="none", privileged_dim=0):
    network = Network(graph_layers=graph_layers, hidden=(32, 32), norm=norm)
    actor = make_actor(graph, 10, 6, network)
    critics = [make_critic(graph, 10, 6, network, privileged_dim) for _ in range(2)]
    for module in (actor, *critics):
        for parameter in module.parameters():  # norms and biases away from ones and zeros
            nn.init.normal_(parameter, std=0.3)
    return actor, critics


def batch(privileged_dim=0):
    def state():
        counters = {"counters": torch.rand(BATCH, privileged_dim)} if privileged_dim else {}
        return {"nodes": torch.randn(BATCH, 8, 10), **counters}

    terminated = torch.rand(BATCH, 1) < 0.3
    end = {"reward": torch.randn(BATCH, 1), "terminated": terminated, "done": terminated | (torch.rand(BATCH, 1) < 0.3)}
    following = {**state(), **end}
    return TensorDict({**state(), "action": 2 * torch.rand(BATCH, 6) - 1, "next": following}, [BATCH])


def move_targets(loss):
    """Move targets away from their sources, equally in every loss."""
    generator = torch.Generator().manual_seed(7)
    for name in LEARNT:
        learnt, target = (getattr(loss, prefix + name).flatten_keys(".") for prefix in ("", "target_"))
        for key, value in sorted(target.data.items()):
            if learnt[key].requires_grad:  # constants of the graph do not
                value.add_(0.1 * torch.randn(value.shape, generator=generator))
                assert not torch.allclose(value, learnt[key])


def gradients(loss):
    return {
        f"{name}.{key}": value.grad
        for name in LEARNT
        for key, value in getattr(loss, name).flatten_keys(".").items()
        if value.requires_grad
    }


def run(loss, data, key):
    """Return the loss dictionary, and the gradients of one of its terms."""
    loss.zero_grad()
    torch.manual_seed(11)  # of the target's noise
    out = loss(data.clone())
    out[key].backward()
    return out, gradients(loss)
