"""Imitation: the actor comes to act as a controller, critics learn first, and the pull fades as stated."""

import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torchrl.envs.utils import ExplorationType, set_exploration_type
from toy_algorithms import KINDS, batch, build, goal

from gctd3.algorithms.imitation import Imitation
from gctd3.algorithms.settings import ImitationSettings
from gctd3.errors import ConfigError

every_algorithm = pytest.mark.parametrize("name", KINDS)


def controller(seen):
    """Act as the toy's best policy does."""
    return goal(seen["nodes"])


def act(policy, nodes):
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        return policy(TensorDict({"nodes": nodes}, [len(nodes)]))["action"]


def parameters(algorithm):
    return {name: value.detach().clone() for name, value in algorithm.actor.named_parameters()}


@every_algorithm
def test_the_policy_begins_as_the_controller(name):
    """After it, the policy to be evaluated acts as the controller on observations that it has not seen."""
    algorithm = build(name)
    imitation = Imitation(ImitationSettings(updates=600), controller)
    nodes = torch.randn(256, 3, 2)
    before = (act(algorithm.policy(), nodes) - goal(nodes)).square().mean()
    told = imitation.begin(algorithm.actor, batch, 3e-3)
    algorithm.average_from_actor()
    after = (act(algorithm.policy(), nodes) - goal(nodes)).square().mean()
    assert after < 0.05 * before and after < 0.01
    assert told == pytest.approx(float(after), rel=1.0)
    torch.testing.assert_close(act(algorithm.policy(), nodes), act(algorithm.actor, nodes))


@every_algorithm
def test_critics_learn_first(name):
    """Until then the actor stays as it is, while the critics change; then it learns."""
    algorithm = build(name)
    algorithm.imitation = Imitation(ImitationSettings(updates=1, critics_first=4, weight=0.0), controller)
    critic = algorithm.critic_optimizer.param_groups[0]["params"][0]
    actor, values = parameters(algorithm), critic.detach().clone()
    for _ in range(4):
        algorithm.update(batch())
    assert all(torch.equal(actor[key], value) for key, value in parameters(algorithm).items())
    assert not torch.equal(values, critic)
    for _ in range(2):
        metrics = algorithm.update(batch())
    assert not all(torch.equal(actor[key], value) for key, value in parameters(algorithm).items())
    assert "loss_actor" in metrics


def test_the_weight_fades_by_hand():
    imitation = Imitation(ImitationSettings(updates=1, weight=12.0, fade=8000), controller)
    assert [imitation.weight(updates) for updates in (0, 2000, 4000, 8000, 9000)] == [12.0, 9.0, 6.0, 0.0, 0.0]


def test_the_term_by_hand():
    """The loss -3 plus its size times the weight, 12 halved, times the mean squared difference of the actions."""

    class Zero(nn.Module):
        in_keys = ("nodes",)

        def forward(self, seen):
            return seen.set("action", torch.zeros(*seen.batch_size, 2))

    seen = TensorDict({"nodes": torch.zeros(5, 3, 2)}, [5])
    imitation = Imitation(ImitationSettings(weight=12.0, fade=10), lambda seen: torch.tensor([[0.1, 0.3]]).expand(5, 2))
    loss = imitation.add_to(torch.tensor(-3.0), Zero(), seen, 5)
    assert float(loss) == pytest.approx(-3.0 + 6.0 * 3.0 * (0.01 + 0.09) / 2)
    assert float(imitation.add_to(torch.tensor(-3.0), Zero(), seen, 10)) == -3.0


def test_batches_of_its_own_by_hand():
    """Where the controller is known for some observations only, the term is on those, drawn anew each time."""

    class Copy(nn.Module):
        in_keys = ("nodes",)

        def forward(self, seen):
            return seen.set("action", seen["nodes"][:, 0])

    def known():
        return TensorDict({"nodes": torch.full((4, 3, 1), 0.5), "action": torch.full((4, 1), 0.2)}, [4])

    seen = TensorDict({"nodes": torch.full((5, 3, 1), 9.0)}, [5])
    imitation = Imitation(ImitationSettings(weight=12.0, fade=10), lambda batch: batch["action"], known)
    assert float(imitation.add_to(torch.tensor(-3.0), Copy(), seen, 5)) == pytest.approx(-3.0 + 6.0 * 3.0 * 0.09)


@pytest.mark.parametrize(("own", "rates"), [(0.4, [0.4, 0.3, 0.2, 0.1]), (None, [0.7] * 4)])
def test_its_own_learning_rate_falls_to_zero(monkeypatch, own, rates):
    used = []

    class Noting(torch.optim.SGD):
        def step(self):
            used.append(self.param_groups[0]["lr"])

    monkeypatch.setattr("gctd3.algorithms.imitation.Adam", Noting)
    algorithm = build("td3")
    Imitation(ImitationSettings(updates=4, initial_learning_rate=own), controller).begin(algorithm.actor, batch, 0.7)
    assert used == pytest.approx(rates)


@pytest.mark.nightly
@pytest.mark.parametrize("name", KINDS)
def test_the_pull_keeps_the_actor_near_the_controller(name):
    """Critics that know nothing lead the actor away; with the term it stays."""
    away = {}
    nodes = torch.randn(256, 3, 2)
    for weight in (0.0, 50.0):
        algorithm = build(name, learning_rate=1e-3)
        algorithm.imitation = Imitation(
            ImitationSettings(updates=600, critics_first=0, weight=weight, fade=10**6), controller
        )
        algorithm.imitation.begin(algorithm.actor, batch, 3e-3)
        for _ in range(150):
            data = batch()
            data["next", "reward"].copy_(data["action"] * 5)  # it pays to go to one end
            algorithm.update(data)
        away[weight] = float((act(algorithm.actor, nodes) - goal(nodes)).square().mean())
    assert away[50.0] < 0.5 * away[0.0]


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"updates": -1}, "updates must be at least 0"),
        ({"retries": -1}, "retries must be at least 0"),
        ({"critics_first": -1}, "critics_first must be at least 0"),
        ({"initial_learning_rate": 0.0}, "initial_learning_rate must be above 0, or null"),
        ({"weight": -1.0}, "weight must be at least 0"),
        ({"fade": 0}, "fade must be at least 1"),
    ],
)
def test_wrong_settings(settings, said):
    with pytest.raises(ConfigError, match=said):
        ImitationSettings(**settings)
