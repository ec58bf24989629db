"""A training that begins from the networks of another run."""

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
import torch
from running import Recorded, command, tiny
from tensordict import TensorDict
from thinned import parametrize

from gctd3.runs.load import load_run
from gctd3.training.checkpoint import Checkpoints

MODELS = Path(__file__).parents[2] / "models"


def networks(run):
    """Return the networks of the newest checkpoint of a run."""
    state, _ = Checkpoints(run).newest()
    return state["algorithm"]["loss"]


def test_they_are_copied_and_trained_on(tmp_path, finished):
    """Without an update the networks are the other run's, target networks included; with updates they are not."""
    # The warm-up ends with the frames, so that there is no update.
    still = ["exploration.learning_starts=83", "total_frames=83"]
    assert command("train", *tiny(tmp_path / "still", *still, f"init={finished['gctd3']}", "seed=7")) == 0
    given, copied = networks(finished["gctd3"]), networks(tmp_path / "still")
    assert given.keys() == copied.keys()
    tensors = [name for name, values in given.items() if isinstance(values, torch.Tensor)]
    assert tensors and all(torch.equal(given[name], copied[name]) for name in tensors)
    # New networks of that seed differ, so that the test sees a copy.
    assert command("train", *tiny(tmp_path / "new", *still, "seed=7")) == 0
    assert any(not torch.equal(given[name], values) for name, values in networks(tmp_path / "new").items())


@pytest.mark.nightly
def test_restarts_begin_from_them_too(tmp_path, finished):
    class Watched(Recorded):
        begun = 0

        def _begin_from_a_run(self):
            Watched.begun += 1
            super()._begin_from_a_run()

    restarting = ["stop_when.restart_after=80", "stop_when.at_least.return_mean=1e6", f"init={finished['gctd3']}"]
    assert command("train", *tiny(tmp_path / "run", *restarting), trainer=Watched) == 0
    assert Watched.begun >= 2


HELD = ["imitation.updates=1", "exploration.learning_starts=20", "algo.learning_rate=0.01"]


def test_critics_learn_what_is_new_before_the_policy_does(tmp_path, finished):
    given, held = finished["gctd3"], [*HELD, "imitation.critics_first=1_000_000"]
    assert command("train", *tiny(tmp_path / "run", *held, f"init={given}", "seed=7")) == 0
    before, after = networks(given), networks(tmp_path / "run")
    same = {name: torch.equal(values, after[name]) for name, values in before.items() if torch.is_tensor(values)}
    assert all(equal for name, equal in same.items() if "actor" in name and "target" not in name)
    trained = [name for name in same if name.startswith("qvalue_network_params.") and name.endswith("weight")]
    assert trained and not any(same[name] for name in trained)


@pytest.mark.nightly
def test_a_policy_is_held_to_the_one_that_it_began_as(tmp_path, finished):
    given, away = finished["gctd3"], {}
    seen = TensorDict({"nodes": torch.randn(50, 8, 10)}, [50])
    first = load_run(given).policy()(seen.clone())["action"]
    for weight in (0, 1000):
        held = [*HELD, "imitation.critics_first=0", f"imitation.weight={weight}", "imitation.fade=1_000_000"]
        assert command("train", *tiny(tmp_path / str(weight), *held, f"init={given}", "seed=7")) == 0
        state = networks(tmp_path / str(weight))
        run = load_run(tmp_path / str(weight))
        algorithm = run.settings.algo.build(run.setup.architecture())
        algorithm.loss.load_state_dict(state)
        with torch.no_grad():
            away[weight] = float((algorithm.actor(seen.clone())["action"] - first).square().mean())
    assert away[1000] < 0.2 * away[0]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (["network.hidden=[8,8]"], r"init=.*: its .* has shape .*, this training's"),
        (["algo=ddpg", "network=gcn"], "its networks have no|has shape|does not fit"),
        (["robot=quadruped"], "has shape"),
    ],
)
def test_networks_that_do_not_fit_are_refused_by_name(tmp_path, finished, capsys, changes, said):
    assert command("train", *tiny(tmp_path / "run", *changes, f"init={finished['gctd3']}")) == 2
    error = capsys.readouterr().err
    assert len(error.strip().splitlines()) == 1
    assert re.search(said, error)


def changed(tmp_path, change):
    """Write a copy of the biped's file, and return how to train it."""
    file = tmp_path / "changed.xml"
    file.write_text(change((MODELS / "biped" / "biped.xml").read_text()))
    return f"robot.name={file}"


def legs_swapped(text):
    """Put the legs, which hang on one body, into the other order."""
    tree = ElementTree.fromstring(text)
    (trunk,) = [body for body in tree.iter("body") if len(body.findall("body")) == 2]
    one, other = trunk.findall("body")
    trunk.remove(one)
    trunk.insert(list(trunk).index(other) + 1, one)
    return ElementTree.tostring(tree, encoding="unicode")


@pytest.mark.parametrize(("network", "code"), [("gcn", 2), ("gcn_shared", 0)])
def test_weights_of_single_joints_need_the_same_order(tmp_path, finished, capsys, network, code):
    """A robot whose left leg comes first does not walk with the right leg's weights."""
    given, still = finished["gctd3"], ["exploration.learning_starts=83", "total_frames=83"]
    if network == "gcn_shared":
        given = tmp_path / "given"
        assert command("train", *tiny(given, *still, "network.readout=joint")) == 0
        still.append("network.readout=joint")
    robot = changed(tmp_path, legs_swapped)
    capsys.readouterr()
    assert command("train", *tiny(tmp_path / "run", *still, robot, f"init={given}")) == code
    said = capsys.readouterr()
    assert ("the same joints in another order" in said.err) == (code == 2)
    assert "other names" not in said.out


def test_joints_of_other_names_are_said(tmp_path, finished, capsys):
    robot = changed(tmp_path, lambda text: text.replace("left", "port"))
    still = ["exploration.learning_starts=83", "total_frames=83"]
    assert command("train", *tiny(tmp_path / "run", *still, robot, f"init={finished['gctd3']}")) == 0
    said = r"joints have other names: the weights of hip_port are those of hip_left there"
    assert re.search(said, capsys.readouterr().out)


@pytest.mark.parametrize("where", ["nowhere", "empty"])
def test_there_must_be_a_checkpoint(tmp_path, capsys, where):
    (tmp_path / "empty").mkdir()
    assert command("train", *tiny(tmp_path / "run", f"init={tmp_path / where}")) == 2
    assert f"init={tmp_path / where}" in capsys.readouterr().err


SIGHT = ["terrain=rough", "task.terrain.levels=1", "task.terrain.length=4", "sight=policy"]


@parametrize(2, "name", ["gctd3", "td3"])
def test_a_flat_policy_begins_on_terrain_with_sight_as_it_was(tmp_path, finished, name):
    """With graph layers and without: new inputs have no effect yet, for the actor and for both critics."""
    given = finished[name]
    still = ["exploration.learning_starts=83", "total_frames=83", f"algo={name}"]
    assert command("train", *tiny(tmp_path / "run", *still, *SIGHT, f"init={given}", "seed=7")) == 0
    old, new = load_run(given), load_run(tmp_path / "run")
    nodes, count = old.setup.graph.num_nodes, old.setup.task.features
    wide = torch.randn(5, nodes, new.setup.task.history, new.setup.task.features)
    narrow = wide[..., :count].flatten(-2)
    action, counters = torch.rand(5, 6), torch.rand(5, old.setup.task.num_counters)
    algorithms = []
    for run, seen in ((old, narrow), (new, wide.flatten(-2))):
        algorithm = run.settings.algo.build(run.setup.architecture())
        algorithm.loss.load_state_dict(networks(run.directory))
        value = {"nodes": seen, "action": action, "counters": counters}
        params = algorithm.loss.qvalue_network_params
        with torch.no_grad(), params[0].to_module(algorithm.loss.qvalue_network):
            q = algorithm.loss.qvalue_network(TensorDict(value, [5]))["state_action_value"]
        with torch.no_grad(), algorithm.loss.actor_network_params.to_module(algorithm.loss.actor_network):
            chosen = algorithm.loss.actor_network(TensorDict({"nodes": seen}, [5]))["action"]
        algorithms.append((chosen, q))
    for one, other in zip(*algorithms, strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=1e-5)


@pytest.mark.nightly
def test_critics_alone_may_see_more_than_before(tmp_path, finished):
    """Their privileged input grows by the scan's 18 rays, whose weights are zero."""
    still = ["exploration.learning_starts=83", "total_frames=83"]
    blind = [*SIGHT[:-1], "sight=critic"]
    assert command("train", *tiny(tmp_path / "run", *still, *blind, f"init={finished['gctd3']}")) == 0
    given, wider = networks(finished["gctd3"]), networks(tmp_path / "run")
    (name,) = [n for n in given if n.startswith("qvalue") and given[n].shape != wider[n].shape]
    count = given[name].shape[-1]
    assert wider[name].shape[-1] == count + 18
    assert torch.equal(wider[name][..., :count], given[name]) and not wider[name][..., count:].any()
