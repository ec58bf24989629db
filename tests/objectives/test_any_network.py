"""TD3Loss and SACLoss on networks and batches of every kind, against TorchRL's: the same losses and gradients."""

import copy
import warnings

import pytest
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
from gctd3.errors import PerformanceWarning
from gctd3.nn import Network, make_actor, make_critic, make_stochastic_actor
from gctd3.nn.layers import Linear
from gctd3.nn.stacking import obstacles, stackable_network

# The sizes of the examples in TorchRL's docstrings; the critic there is `ValueClass`.
N_ACT, N_OBS = 4, 3
SPEC = Bounded(-torch.ones(N_ACT), torch.ones(N_ACT), (N_ACT,))
KEYS = ["observation", "action"]

pytestmark = [
    pytest.mark.filterwarnings("ignore::gctd3.errors.PerformanceWarning"),
    # TorchRL's, of target parameters that nothing updates.
    pytest.mark.filterwarnings("ignore:No target network updater:UserWarning"),
]


class ValueClass(nn.Module):
    def __init__(self, layer=nn.Linear):
        super().__init__()
        self.linear = layer(N_OBS + N_ACT, 1)

    def forward(self, obs, act):
        return self.linear(torch.cat([obs, act], -1))


@stackable_network
class Quadratic(nn.Module):
    """A critic of one's own that takes stacked parameters: (w . [obs, act])^2, for any batch."""

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
    "the same twice": lambda: [ValueOperator(module=ValueClass(), in_keys=KEYS)] * 2,
    "mlp": lambda: [ValueOperator(MLP(out_features=1, num_cells=[8, 8], in_features=7), KEYS) for _ in range(2)],
    "plain": lambda: [TensorDictModule(ValueClass(), KEYS, ["state_action_value"]) for _ in range(2)],
    "our layer in a forward of its own": lambda: [
        TensorDictModule(ValueClass(Linear), KEYS, ["state_action_value"]) for _ in range(2)
    ],
    "declared": lambda: [TensorDictModule(Quadratic(), KEYS, ["state_action_value"]) for _ in range(2)],
    "declared, one": lambda: TensorDictModule(Quadratic(), KEYS, ["state_action_value"]),
}
STACKED = {"declared", "declared, one"}
BATCHES = [(2,), (5,), (4, 8), (2, 2), (2, 3, 2), ()]


def data(batch, horizon=False):
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
    """A loss on copies of the networks, made from the same seed."""
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
    """What the loss says, what it writes, and the gradients of each of its terms."""
    written = batch.clone()
    torch.manual_seed(4)
    out = loss(written)
    found = {}
    for term in sorted(key for key in out.keys() if key.startswith("loss_")):
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


each_loss = pytest.mark.parametrize("name, actor", [("TD3Loss", td3_actor), ("SACLoss", sac_actor)])


@pytest.mark.parametrize("batch", BATCHES, ids=str)
@pytest.mark.parametrize("kind", CRITICS)
@each_loss
def test_equals_torchrls(name, actor, kind, batch):
    mine, theirs = pair(name, actor(), CRITICS[kind]())
    assert mine.stacked == (kind in STACKED)
    assert_equal(mine, theirs, data(batch), mine.stacked)


@pytest.mark.parametrize(
    "settings",
    [
        {"loss_function": "l2"},
        {"reduction": "sum"},
        {"delay_qvalue": False},
        {"delay_actor": True},
        {"separate_losses": True},
        {"deactivate_vmap": True},
        {"estimator": ValueEstimators.TDLambda},
        {"estimator": ValueEstimators.TD1},
    ],
    ids=str,
)
@pytest.mark.parametrize("kind", ["docstring", "list", "declared"])
@each_loss
def test_equals_torchrls_with_other_settings(name, actor, kind, settings):
    mine, theirs = pair(name, actor(), CRITICS[kind](), **settings)
    assert_equal(mine, theirs, data((4, 8)), mine.stacked)


@pytest.mark.parametrize("kind", ["docstring", "declared"])
def test_sac_with_a_value_network(kind):
    value = ValueOperator(module=nn.Linear(N_OBS, 1), in_keys=["observation"])
    mine, theirs = pair("SACLoss", sac_actor(), CRITICS[kind](), value)
    assert_equal(mine, theirs, data((4, 8)))


@pytest.mark.parametrize("reverse", [False, True], ids=["ours first", "theirs first"])
@each_loss
def test_one_critic_of_ours_and_one_that_is_not(name, actor, reverse):
    """Their parameters fit one another; a declared class beside one that only looks like it is no stack."""

    class Undeclared(Quadratic):
        pass

    critics = [TensorDictModule(kind(), KEYS, ["state_action_value"]) for kind in (Quadratic, Undeclared)]
    mine, theirs = pair(name, actor(), critics[::-1] if reverse else critics)
    assert not mine.stacked
    assert_equal(mine, theirs, data((4, 8)))


@each_loss
def test_keywords_instead_of_a_tensordict(name, actor):
    """As the docstrings' second examples call the losses."""
    flat = {"_".join(key) if isinstance(key, tuple) else key: v for key, v in data((2,)).items(True, True)}
    found = []
    for loss in pair(name, actor(), CRITICS["docstring"]()):
        _ = loss.select_out_keys("loss_actor", "loss_qvalue")
        torch.manual_seed(4)
        loss_actor, loss_qvalue = loss(**flat)
        loss_actor.backward()
        found.append([loss_actor, loss_qvalue, *(p.grad for p in loss.actor_network_params.parameters())])
    for one, other in zip(*found, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-6, atol=1e-6)


@each_loss
def test_keys_may_have_other_names(name, actor):
    def renamed(batch):
        for old, new in (("action", ("agent", "act")), ("observation", ("agent", "obs"))):
            batch = batch.rename_key_(old, new)
        return batch.rename_key_(("next", "observation"), ("next", "agent", "obs"))

    spec = {"in_keys": [("agent", "obs")], "out_keys": [("agent", "act")]}
    if name == "TD3Loss":
        policy = TensorDictModule(nn.Linear(N_OBS, N_ACT), **spec)
    else:
        net = nn.Sequential(nn.Linear(N_OBS, 2 * N_ACT), NormalParamExtractor())
        module = TensorDictModule(net, in_keys=spec["in_keys"], out_keys=["loc", "scale"])
        policy = ProbabilisticActor(
            module, in_keys=["loc", "scale"], out_keys=spec["out_keys"], distribution_class=TanhNormal
        )
    for network in (ValueClass, Quadratic):
        critics = [TensorDictModule(network(), [("agent", "obs"), ("agent", "act")], ["q"]) for _ in range(2)]
        mine, theirs = pair(name, policy, critics, delay_qvalue=False)
        for loss in (mine, theirs):
            loss.set_keys(action=("agent", "act"), state_action_value="q")
        assert mine.stacked == (network is Quadratic)
        assert_equal(mine, theirs, renamed(data((4, 8))), mine.stacked)


def test_a_critic_that_reads_what_the_actor_writes():
    class TwoOutputs(nn.Module):
        def __init__(self):
            super().__init__()
            self.body, self.head = nn.Linear(N_OBS, N_OBS), nn.Linear(N_OBS, N_ACT)

        def forward(self, obs):
            code = torch.tanh(self.body(obs))
            return code, torch.tanh(self.head(code))

    actor = TensorDictModule(TwoOutputs(), ["observation"], ["code", "action"])
    critics = [TensorDictModule(Quadratic(), ["code", "action"], ["state_action_value"]) for _ in range(2)]
    batch = data((4, 8))
    batch["code"] = torch.randn(4, 8, N_OBS)
    mine, theirs = pair("TD3Loss", actor, critics)
    assert not mine.stacked
    assert_equal(mine, theirs, batch)


def test_what_stays_the_same_may_stand_beside_next_only():
    """TorchRL takes it for the next state, too."""
    batch = data((4, 8))
    del batch["next", "observation"]
    for kind in ("docstring", "declared"):
        mine, theirs = pair("TD3Loss", td3_actor(), CRITICS[kind]())
        assert_equal(mine, theirs, batch, mine.stacked)


# gctd3's own networks, on batches of more than one dimension: as many as there are critics, too.


@pytest.mark.parametrize("batch", [(4, 8), (2, 3), ()], ids=str)
@pytest.mark.parametrize(
    "network",
    [
        Network(graph_norm="layer", norm="layer", residual=True, hidden=(16, 16)),
        Network((16,), readout="joint", hidden=(16, 16)),
        Network((), hidden=(16, 16)),
        Network((16,), chebyshev=2, hidden=(16,)),
    ],
    ids=["norms", "joint", "mlp", "chebyshev"],
)
@pytest.mark.parametrize("name, maker", [("TD3Loss", make_actor), ("SACLoss", make_stochastic_actor)])
def test_our_networks_on_any_batch(graph, name, maker, network, batch):
    actor, critics = maker(graph, network=network), [make_critic(graph, network=network) for _ in range(2)]
    torch.manual_seed(1)
    terminated = torch.rand(*batch, 1) < 0.3
    following = {"nodes": torch.randn(*batch, 8, 10), "reward": torch.randn(*batch, 1)}
    following |= {"terminated": terminated, "done": terminated.clone()}
    seen = {"nodes": torch.randn(*batch, 8, 10), "action": torch.rand(*batch, 6) * 1.8 - 0.9}
    both = TensorDict({**seen, "next": TensorDict(following, batch)}, batch).double()
    mine, theirs = pair(name, actor.double(), [critic.double() for critic in critics])
    assert mine.stacked
    assert_equal(mine, theirs, both, stacked=True)


@pytest.mark.parametrize("name, actor", [("TD3Loss", td3_actor), ("SACLoss", sac_actor)])
def test_a_loss_that_is_moved_copied_or_told_of_randomness_goes_on(name, actor):
    for kind in ("list", "declared"):
        mine, theirs = pair(name, actor(), CRITICS[kind]())
        batch = data((4, 8))
        results(mine, batch)
        for change in (
            lambda loss: loss.double(),
            copy.deepcopy,
            lambda loss: loss.set_vmap_randomness("different") or loss,
        ):
            mine, theirs = change(mine), change(theirs)
            double = batch.double()
            assert_equal(mine, theirs, double, mine.stacked)


# What is said, and of what.


def test_a_slow_loss_says_so_once_in_one_line():
    with pytest.warns(PerformanceWarning) as said:
        loss = make(ours, "TD3Loss", td3_actor(), CRITICS["plain"]())
        loss(data((4,)))
        loss(data((4,)))
    (line,) = [str(one.message) for one in said if one.category is PerformanceWarning]
    assert "\n" not in line
    assert "TD3Loss" in line and "slower" in line and "torch's Linear" in line
    assert said[0].filename == __file__


def test_a_stacked_loss_says_nothing(graph):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        make(ours, "TD3Loss", make_actor(graph), [make_critic(graph) for _ in range(2)])


def wrapped(critic):
    return TensorDictModule(critic, ["nodes", "action"], ["state_action_value"])


def test_one_unknown_module_anywhere_is_an_obstacle(graph):
    assert obstacles(make_critic(graph)) == []
    plain = make_critic(graph)
    plain.module.head[0] = nn.Linear(plain.module.head[0].in_features, 256)
    assert obstacles(plain) == ["torch's Linear not declared to take stacked parameters"]
    random = make_critic(graph)
    random.module.head[1] = nn.Dropout()
    assert "Dropout" in obstacles(random)[0]

    class Subclass(type(make_critic(graph).module)):
        pass

    assert "Subclass" in obstacles(wrapped(Subclass(Network(), graph, 10, 6)))[0]
    hooked = make_critic(graph)
    hooked.module.head[0].register_forward_hook(lambda *_: None)
    assert "Linear" in obstacles(hooked)[0]
    patched = make_critic(graph)
    patched.module.encoder.forward = lambda nodes: nodes.flatten(-2)
    assert "GraphEncoder" in obstacles(patched)[0]
    # A layer does not say where a batch ends; only a network does.
    assert "whole network" in obstacles(TensorDictModule(Linear(3, 1), ["x"], ["state_action_value"]))[0]
