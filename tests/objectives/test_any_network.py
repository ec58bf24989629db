"""TD3Loss and SACLoss give TorchRL's losses and gradients on networks and batches of every kind."""

import copy
import warnings

import pytest
import torch
from losses import (
    CRITICS,
    KEYS,
    N_ACT,
    N_OBS,
    STACKED,
    Quadratic,
    ValueClass,
    assert_equal,
    data,
    double,
    make,
    pair,
    results,
    sac_actor,
    td3_actor,
)
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl import objectives as torchrl
from torchrl.modules import ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.modules.distributions import NormalParamExtractor
from torchrl.objectives import ValueEstimators

from gctd3 import objectives as ours
from gctd3.errors import PerformanceWarning
from gctd3.nn import Network, make_actor, make_critic, make_stochastic_actor

BATCHES = [(2,), (5,), (4, 8), (2, 2), (2, 3, 2), ()]
pytestmark = [
    pytest.mark.filterwarnings("ignore::gctd3.errors.PerformanceWarning"),
    # TorchRL's, of target parameters that nothing updates.
    pytest.mark.filterwarnings("ignore:No target network updater:UserWarning"),
]

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
    """A declared critic and an undeclared one with parameters of equal shapes do not run as a stack."""

    class Undeclared(Quadratic):
        pass

    critics = [TensorDictModule(kind(), KEYS, ["state_action_value"]) for kind in (Quadratic, Undeclared)]
    mine, theirs = pair(name, actor(), critics[::-1] if reverse else critics)
    assert not mine.stacked
    assert_equal(mine, theirs, data((4, 8)))


@each_loss
def test_keywords_instead_of_a_tensordict(name, actor):
    """Losses can be called as in the second examples of TorchRL's docstrings."""
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
    """A key that does not change may stand beside ``"next"`` only; it serves the next state too."""
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
    both = double(TensorDict({**seen, "next": TensorDict(following, batch)}, batch))
    mine, theirs = pair(name, actor.double(), [critic.double() for critic in critics])
    assert mine.stacked
    assert_equal(mine, theirs, both, stacked=name == "TD3Loss")


@pytest.mark.parametrize("kind", ["list", "declared"])
@each_loss
def test_a_loss_that_is_moved_copied_or_told_of_randomness_goes_on(name, actor, kind):
    mine, theirs = pair(name, actor(), CRITICS[kind]())
    if mine.stacked or name == "TD3Loss":  # TorchRL's go on with old parameters if they were called before
        results(mine, data((4, 8)))
    mine, theirs = mine.double(), theirs.double()
    assert_equal(mine, theirs, double(data((4, 8))), mine.stacked)
    mine, theirs = copy.deepcopy(mine), copy.deepcopy(theirs)
    assert_equal(mine, theirs, double(data((4, 8))), mine.stacked)
    for loss in (mine, theirs):
        loss.set_vmap_randomness("different")
    assert_equal(mine, theirs, double(data((4, 8))), mine.stacked)


@pytest.mark.parametrize("kind", [ValueClass, Quadratic])
@each_loss
def test_one_critic_twice_is_trained_once(name, actor, kind):
    """One critic passed twice gets the sum of both gradients, as with TorchRL's expanded parameters."""
    found = []
    for library in (ours, torchrl):
        torch.manual_seed(0)
        critic = TensorDictModule(kind(), KEYS, ["state_action_value"])
        extra = {"bounds": (-1.0, 1.0)} if name == "TD3Loss" else {"target_entropy": -float(N_ACT)}
        loss = getattr(library, name)(actor(), [critic, critic], **extra)
        torch.manual_seed(4)
        out = loss(data((4, 8)))
        out["loss_qvalue"].backward()
        found.append([out["loss_qvalue"], out["loss_actor"], *(p.grad for p in critic.parameters())])
    for one, other in zip(*found, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-6, atol=1e-6)


# What is said, and of what.


def test_a_slow_loss_says_so_once_in_one_line():
    with pytest.warns(PerformanceWarning) as said:
        loss = make(ours, "TD3Loss", td3_actor(), CRITICS["plain"]())
        loss(data((4,)))
        loss(data((4,)))
    (line,) = [str(one.message) for one in said if one.category is PerformanceWarning]
    assert "\n" not in line
    assert "TD3Loss" in line and "slower" in line and "torch's Linear" in line
    assert said[0].filename == make.__code__.co_filename  # where the loss is made


def test_a_stacked_loss_says_nothing(graph):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        make(ours, "TD3Loss", make_actor(graph), [make_critic(graph) for _ in range(2)])
