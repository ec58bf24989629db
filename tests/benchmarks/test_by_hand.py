"""The benchmark's lower bound does the work of a TD3 update: its gradients and steps equal autograd's and Adam's."""

import importlib
from pathlib import Path

import pytest
import torch
from torch import nn
from torch.nn.functional import mse_loss

STATE, ACTIONS, BATCH = 5, 3, 7


@pytest.fixture
def by_hand(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))
    torch.manual_seed(0)
    return importlib.import_module("by_hand").TD3ByHand(STATE, ACTIONS, BATCH, hidden=(8, 6))


def modules(networks):
    """Return the same networks as PyTorch's modules."""
    made = []
    for i in range(len(networks.weights[0])):
        layers = []
        for weight, bias in zip(networks.weights, networks.biases, strict=True):
            layer = nn.Linear(weight.shape[2], weight.shape[1])
            layer.weight.data, layer.bias.data = weight[i].clone(), bias[i].clone()
            layers += [layer, nn.ReLU()]
        made.append(nn.Sequential(*layers[:-1]))
    return made


def gradients(made):
    weights = [[m[i].weight.grad for m in made] for i in (0, 2, 4)]
    biases = [[m[i].bias.grad for m in made] for i in (0, 2, 4)]
    return [torch.stack(parts) for parts in weights + biases]


def test_gradients_are_autograds(by_hand):
    (actor,), critics = modules(by_hand.actor), modules(by_hand.critics)
    (target_actor,), target_critics = modules(by_hand.target_actor), modules(by_hand.target_critics)
    noise = torch.randn(BATCH, ACTIONS)
    with torch.no_grad():
        action = (target_actor(by_hand.following).tanh() + (0.2 * noise).clamp(-0.5, 0.5)).clamp(-1, 1)
        pairs = torch.cat([by_hand.following, action], 1)
        value = torch.minimum(*(critic(pairs) for critic in target_critics)).squeeze(1)
        target = by_hand.rewards + 0.99 * (1 - by_hand.terminated) * value
    torch.testing.assert_close(by_hand.target(noise), target)

    taken = torch.cat([by_hand.states, by_hand.actions], 1)
    sum(mse_loss(critic(taken).squeeze(1), target) for critic in critics).backward()
    torch.testing.assert_close(by_hand.critic_gradients(target), gradients(critics))

    (-critics[0](torch.cat([by_hand.states, actor(by_hand.states).tanh()], 1)).mean()).backward()
    torch.testing.assert_close(by_hand.actor_gradients(), gradients([actor]))


def test_updates_step_down_the_gradient_as_adam_does_and_move_the_targets(by_hand):
    (actor,), critics = modules(by_hand.actor), modules(by_hand.critics)
    adams = [torch.optim.Adam([p for c in critics for p in c.parameters()], lr=3e-4)]
    adams.append(torch.optim.Adam(actor.parameters(), lr=3e-4))
    before = [p.clone() for p in by_hand.target_actor.parameters()]
    for update in (1, 2):
        torch.manual_seed(update)
        target = by_hand.target(torch.randn(BATCH, ACTIONS))
        adams[0].zero_grad()
        taken = torch.cat([by_hand.states, by_hand.actions], 1)
        sum(mse_loss(critic(taken).squeeze(1), target) for critic in critics).backward()
        adams[0].step()
        torch.manual_seed(update)
        by_hand.update()
    (-critics[0](torch.cat([by_hand.states, actor(by_hand.states).tanh()], 1)).mean()).backward()
    adams[1].step()
    for layer, (weight, bias) in enumerate(zip(by_hand.critics.weights, by_hand.critics.biases, strict=True)):
        for i, critic in enumerate(critics):
            torch.testing.assert_close(weight[i], critic[2 * layer].weight.detach())
            torch.testing.assert_close(bias[i], critic[2 * layer].bias.detach())
    for layer, weight in enumerate(by_hand.actor.weights):
        torch.testing.assert_close(weight[0], actor[2 * layer].weight.detach())
    for old, new, learnt in zip(before, by_hand.target_actor.parameters(), by_hand.actor.parameters(), strict=True):
        torch.testing.assert_close(new, old + 0.005 * (learnt - old))
