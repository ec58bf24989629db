"""Networks of PyTorch's own layers go through everything that gctd3's go through."""

import copy
import json

import plain_networks
import pytest
import torch
from running import command, rows, train
from test_algorithms import PRIVILEGED, act, assert_identical, batch, build, goal, going_on
from torch import nn

from gctd3.errors import PerformanceWarning

KINDS = {"td3": "PlainTD3", "sac": "PlainSAC", "ddpg": "PlainDDPG"}
each = pytest.mark.parametrize("name", KINDS)


def quick(*names):
    """Parametrise over the kinds: those that are not named run every night."""
    return pytest.mark.parametrize(
        "name", [name if name in names else pytest.param(name, marks=pytest.mark.nightly) for name in KINDS]
    )


# DDPG has one critic, so it has no vmap and no warning.
pytestmark = pytest.mark.filterwarnings("ignore::gctd3.errors.PerformanceWarning")


def plain(name, privileged_dim=PRIVILEGED, **settings):
    return build(name, None, privileged_dim, plain_networks.PlainArchitecture, **settings)


@quick("td3", "ddpg")
def test_learns_a_toy_problem(name):
    settings = {"alpha": 0.05} if name == "sac" else {}
    algorithm = plain(name, 0, learning_rate=3e-3, tau=0.05, **settings)
    assert not any(type(part).__module__.startswith("gctd3") for part in algorithm.actor.modules())
    nodes = batch(512)["nodes"]

    def error():
        return float((act(algorithm.policy(), nodes) - goal(nodes)).pow(2).mean())

    assert error() > 0.2
    for _ in range(300):
        algorithm.update(batch())
    assert error() < 0.08


@each
def test_privileged_critics_and_a_restored_state(name):
    first, other = plain(name), plain(name, seed=7)
    first.update(going_on())
    other.load_state_dict(copy.deepcopy(first.state_dict()))
    for algorithm in (first, other):
        torch.manual_seed(3)
        for _ in range(3):
            algorithm.update(going_on())
    assert_identical(first, other)
    changed = going_on()
    losses = []
    for here, there in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)):
        data = changed.clone()
        data["counters"] += here
        data["next", "counters"] += there
        losses.append(float(plain(name, gamma=0.9).update(data)["loss_critic"]))
    assert len(set(losses)) == 3


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning", "ignore::UserWarning")
def test_traced_losses_update_as_they_are(monkeypatch):
    compiler = torch.compile
    monkeypatch.setattr(torch, "compile", lambda function, mode: compiler(function, backend="eager"))
    states = []
    for compiled in (False, True):
        algorithm = plain("td3", compile=compiled)
        for i in range(4):
            torch.manual_seed(i)
            algorithm.update(going_on())
        states.append(algorithm.state_dict()["loss"])
    for key, value in states[0].items():
        torch.testing.assert_close(value, states[1][key])


@quick("td3")
def test_trains_and_is_evaluated_from_the_command_line(tmp_path, name):
    run = train(tmp_path / "run", f"algo={name}", f"algo._target_=plain_networks.{KINDS[name]}")
    assert float(rows(run)[-1]["updates"]) > 0
    assert command("evaluate", f"run={run}", "episodes=2", f"out={tmp_path / 'evaluated'}") == 0
    assert json.loads((tmp_path / "evaluated" / "evaluation.json").read_text())


@pytest.mark.nightly
def test_a_training_says_that_it_is_slower(tmp_path):
    with pytest.warns(PerformanceWarning) as said:
        train(tmp_path / "run", "algo=td3", "algo._target_=plain_networks.PlainTD3")
    # Python shows the warning once, though the networks are built twice, first to check the settings.
    assert (
        len({(str(one.message), one.filename, one.lineno) for one in said if one.category is PerformanceWarning}) == 1
    )


@pytest.mark.nightly
def test_a_network_that_is_ours_in_parts(tmp_path):
    """A subclass of ``Network`` with fully connected layers of PyTorch trains."""
    target = "network._target_=plain_networks.PlainHead"
    assert rows(train(tmp_path / "run", "algo=sac", target))
    assert isinstance(plain_networks.PlainHead().head(3, 1)[0], nn.Linear)
