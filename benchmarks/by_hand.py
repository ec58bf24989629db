"""The arithmetic of a TD3 update of an MLP and nothing else: a bound on what a library over PyTorch can reach.

No autograd, modules, TensorDicts, optimiser classes or replay: gradients by hand, activations overwritten in place,
both critics as one batched product, PyTorch's fused Adam. ``learner_throughput.py`` times it beside the libraries;
``tests/benchmarks/test_by_hand.py`` checks it against autograd.
"""

from __future__ import annotations

import itertools

import torch
from torch import Tensor

RATE, TAU, GAMMA, NOISE, CLIP = 3e-4, 0.005, 0.99, 0.2, 0.5


class Networks:
    """``E`` networks of two hidden layers: weights ``[E, O, I]``, biases ``[E, O]``, Adam's state."""

    def __init__(self, networks: int, sizes: tuple[int, ...]) -> None:
        pairs = list(itertools.pairwise(sizes))
        self.weights = [torch.randn(networks, o, i) / i**0.5 for i, o in pairs]
        self.biases = [torch.zeros(networks, o) for _, o in pairs]
        self.first = [torch.zeros_like(p) for p in self.parameters()]
        self.second = [torch.zeros_like(p) for p in self.parameters()]
        self.steps = [torch.tensor(0.0) for _ in self.first]

    def parameters(self) -> list[Tensor]:
        """Weights, then biases."""
        return self.weights + self.biases

    def forward(self, x: Tensor, one: bool = False) -> list[Tensor]:
        """Input and output of every layer, all ``[E, B, *]``; ``one``: of the first network only."""
        passed = [x]
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            weight, bias = (weight[:1], bias[:1]) if one else (weight, bias)
            if len(weight) > 1:
                out = torch.baddbmm(bias.unsqueeze(1), passed[-1].expand(len(weight), *x.shape[-2:-1], -1), weight.mT)
            else:
                out = torch.addmm(bias[0], passed[-1].reshape(x.shape[-2], -1), weight[0].T).unsqueeze(0)
            passed.append(out if layer == len(self.weights) - 1 else out.relu_())
        return passed

    def backward(
        self, passed: list[Tensor], gradient: Tensor, for_input: bool = False
    ) -> tuple[list[Tensor], Tensor | None]:
        """Compute the parameters' gradients, or only the input's, from the output's gradient ``[E, B, O]``."""
        weights, biases = [], []
        for layer in reversed(range(len(self.weights))):
            weight, x = self.weights[layer][: len(gradient)], passed[layer]
            if not for_input:
                weights.insert(0, _product(gradient.mT, x.expand(len(gradient), *x.shape[-2:])))
                biases.insert(0, gradient.sum(1))
            if layer or for_input:
                gradient = _product(gradient, weight)
            if layer:
                torch.ops.aten.threshold_backward.grad_input(gradient, x, 0, grad_input=gradient)
        return weights + biases, gradient if for_input else None

    def step(self, gradients: list[Tensor]) -> None:
        """Adam."""
        torch._foreach_add_(self.steps, 1.0)
        torch._fused_adam_(
            self.parameters(), gradients, self.first, self.second, [], self.steps, lr=RATE, beta1=0.9, beta2=0.999,
            weight_decay=0.0, eps=1e-8, amsgrad=False, maximize=False,
        )  # fmt: skip


def _product(a: Tensor, b: Tensor) -> Tensor:
    return torch.bmm(a, b) if len(a) > 1 else torch.mm(a[0], b[0]).unsqueeze(0)


class TD3ByHand:
    """TD3 on one random batch.

    Args:
        state: Numbers in a state.
        actions: Numbers in an action.
        batch: Transitions of an update.
        hidden: Units of each hidden layer.
    """

    def __init__(self, state: int, actions: int, batch: int, hidden: tuple[int, int] = (256, 256)) -> None:
        sizes = (state, *hidden, actions), (state + actions, *hidden, 1)
        self.actor, self.target_actor = Networks(1, sizes[0]), Networks(1, sizes[0])
        self.critics, self.target_critics = Networks(2, sizes[1]), Networks(2, sizes[1])
        self.states, self.following = torch.randn(batch, state), torch.randn(batch, state)
        self.actions = torch.rand(batch, actions) * 2 - 1
        self.rewards, self.terminated = torch.randn(batch), (torch.rand(batch) < 0.02).float()
        self.updates = 0

    @torch.no_grad()
    def update(self) -> None:
        """One update of the critics, every second time also of the actor and the targets."""
        self.updates += 1
        target = self.target(torch.randn_like(self.actions))
        self.critics.step(self.critic_gradients(target))
        if self.updates % 2 == 0:
            self.actor.step(self.actor_gradients())
            targets = self.target_critics.parameters() + self.target_actor.parameters()
            torch._foreach_lerp_(targets, self.critics.parameters() + self.actor.parameters(), TAU)

    def target(self, noise: Tensor) -> Tensor:
        """Compute the target of the critics' values, ``[B]``, with standard normal ``noise``."""
        action = self.target_actor.forward(self.following)[-1][0].tanh_()
        action = (action + (noise * NOISE).clamp_(-CLIP, CLIP)).clamp_(-1.0, 1.0)
        value = self.target_critics.forward(torch.cat([self.following, action], 1))[-1].squeeze(-1).min(0)[0]
        return self.rewards + GAMMA * (1.0 - self.terminated) * value

    def critic_gradients(self, target: Tensor) -> list[Tensor]:
        """Compute the gradients of the sum of the critics' mean squared errors."""
        passed = self.critics.forward(torch.cat([self.states, self.actions], 1))
        error = passed[-1] - target.unsqueeze(-1)
        return self.critics.backward(passed, error * (2.0 / len(target)))[0]

    def actor_gradients(self) -> list[Tensor]:
        """Compute the gradients of minus the first critic's mean value of the actor's actions."""
        batch = len(self.states)
        passed = self.actor.forward(self.states)
        action = passed[-1][0].tanh_()
        valued = self.critics.forward(torch.cat([self.states, action], 1), one=True)
        _, gradient = self.critics.backward(valued, torch.full((1, batch, 1), -1.0 / batch), for_input=True)
        assert gradient is not None
        return self.actor.backward(passed, gradient[..., self.states.shape[1] :] * (1.0 - action * action))[0]
