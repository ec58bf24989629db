"""Make losses for tests: ours and TorchRL's side by side, on networks of plain layers."""

import copy

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl import objectives as torchrl
from torchrl.data import Bounded
from torchrl.modules import MLP, Actor, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.modules.distributions import NormalParamExtractor
from torchrl.objectives import SoftUpdate, ValueEstimators

from gctd3 import objectives as ours
from gctd3.nn.layers import Linear
from gctd3.nn.stacking import stackable_network

# The sizes of the examples in TorchRL's docstrings; the critic there is `ValueClass`.
N_ACT, N_OBS = 4, 3
SPEC = Bounded(-torch.ones(N_ACT), torch.ones(N_ACT), (N_ACT,))
KEYS = ["observation", "action"]


class ValueClass(nn.Module):
    def __init__(self, layer=nn.Linear):
        super().__init__()
        self.linear = layer(N_OBS + N_ACT, 1)

    def forward(self, obs, act):
        return self.linear(torch.cat([obs, act], -1))


@stackable_network
class Quadratic(nn.Module):
    """Define a critic outside the library that takes stacked parameters: (w . [obs, act])^2, for any batch."""

    def __init__(self):
        super().__init__()
        self.weight = nn.Parameter(torch.randn(N_OBS + N_ACT))

    def forward(self, obs, act):
        x = torch.cat([obs, act], -1)
        if self.weight.ndim == 1:
            return (x @ self.weight).square().unsqueeze(-1)
        return torch.einsum("...i,ei->e...", x, self.weight).square().unsqueeze(-1)


def td3_actor():
    return Actor(module=nn.Linear(N_OBS, N_ACT), spec=SPEC)


def sac_actor():
    net = nn.Sequential(nn.Linear(N_OBS, 2 * N_ACT), NormalParamExtractor())
    module = TensorDictModule(net, in_keys=["observation"], out_keys=["loc", "scale"])
    return ProbabilisticActor(module=module, in_keys=["loc", "scale"], spec=SPEC, distribution_class=TanhNormal)


CRITICS = {
    "docstring": lambda: ValueOperator(module=ValueClass(), in_keys=KEYS),
    "list": lambda: [ValueOperator(module=ValueClass(), in_keys=KEYS) for _ in range(2)],
    "mlp": lambda: [ValueOperator(MLP(out_features=1, num_cells=[8, 8], in_features=7), KEYS) for _ in range(2)],
    "plain": lambda: [TensorDictModule(ValueClass(), KEYS, ["state_action_value"]) for _ in range(2)],
    "our layer in a forward of its own": lambda: [
        TensorDictModule(ValueClass(Linear), KEYS, ["state_action_value"]) for _ in range(2)
    ],
    "declared": lambda: [TensorDictModule(Quadratic(), KEYS, ["state_action_value"]) for _ in range(2)],
    "declared, one": lambda: TensorDictModule(Quadratic(), KEYS, ["state_action_value"]),
}
STACKED = {"declared", "declared, one"}


def double(batch):
    return batch.apply(lambda value: value.double() if value.is_floating_point() else value)


def data(batch):
    torch.manual_seed(1)
    terminated = torch.rand(*batch, 1) < 0.3
    following = {
        "observation": torch.randn(*batch, N_OBS),
        "reward": torch.randn(*batch, 1),
        "terminated": terminated,
        "done": terminated | (torch.rand(*batch, 1) < 0.3),
    }
    seen = {"observation": torch.randn(*batch, N_OBS), "action": torch.rand(*batch, N_ACT) * 1.8 - 0.9}
    return TensorDict({**seen, "next": TensorDict(following, batch)}, batch)


def make(library, name, actor, critics, *more, estimator=ValueEstimators.TD0, **settings):
    """Make a loss on copies of the networks, from the same seed."""
    kind = getattr(library, name)
    extra = {"bounds": (-1.0, 1.0)} if name == "TD3Loss" else {"target_entropy": -float(N_ACT)}
    torch.manual_seed(2)  # of a single critic TorchRL draws several
    loss = kind(*copy.deepcopy((actor, critics, *more)), **{**extra, **settings})
    loss.make_value_estimator(estimator, gamma=0.9)
    if settings.get("delay_qvalue", True):
        SoftUpdate(loss, tau=0.1)
        torch.manual_seed(3)
        for name in sorted(n for n, _ in loss.named_children() if n.startswith("target_")):
            for _, value in sorted(getattr(loss, name).flatten_keys(".").items()):
                value.data.add_(0.1 * torch.randn(value.shape))  # away from what they follow
    return loss


def results(loss, batch):
    """Return the loss dictionary, the written keys, and the gradients of each term."""
    written = batch.clone()
    torch.manual_seed(4)
    out = loss(written)
    found = {}
    for term in sorted(filter(lambda key: key.startswith("loss_"), out.keys())):
        loss.zero_grad()
        out[term].mean().backward(retain_graph=True)
        found[term] = {n: None if p.grad is None else p.grad.clone() for n, p in loss.named_parameters()}
    return out, written, found


def assert_equal(mine, theirs, batch, stacked=False):
    (out, written, gradients), (expected, their_written, their_gradients) = results(mine, batch), results(theirs, batch)
    close = {"rtol": 1e-6, "atol": 1e-6}
    assert set(out.keys()) == set(expected.keys())
    for key, value in expected.items():
        if key == "state_action_value_actor" and stacked:
            value = value[0]  # a stack evaluates the one critic that is used
        torch.testing.assert_close(out[key], value, **close)
    assert set(written.keys(True)) == set(their_written.keys(True))
    torch.testing.assert_close(written["td_error"], their_written["td_error"], **close)
    for term, expected in their_gradients.items():
        assert gradients[term].keys() == expected.keys()
        assert any(gradient is not None and gradient.any() for gradient in expected.values()), term
        for name, gradient in expected.items():
            if gradient is None or not gradient.any():  # isolation: what a term does not train stays untouched
                assert gradients[term][name] is None or not gradients[term][name].any(), (term, name)
            else:
                torch.testing.assert_close(gradients[term][name], gradient, **close)


def pair(name, *networks, **settings):
    return [make(library, name, *networks, **settings) for library in (ours, torchrl)]
