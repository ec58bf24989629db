"""A training that begins from the networks of another run."""

import re

import pytest
import torch
from running import Recorded, command, tiny

from gctd3.training.checkpoint import Checkpoints


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


def test_restarts_begin_from_them_too(tmp_path, finished):
    class Watched(Recorded):
        begun = 0

        def _begin_from_a_run(self):
            Watched.begun += 1
            super()._begin_from_a_run()

    restarting = ["stop_when.restart_after=80", "stop_when.at_least.return_mean=1e6", f"init={finished['gctd3']}"]
    assert command("train", *tiny(tmp_path / "run", *restarting), trainer=Watched) == 0
    assert Watched.begun >= 2


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


@pytest.mark.parametrize("where", ["nowhere", "empty"])
def test_there_must_be_a_checkpoint(tmp_path, capsys, where):
    (tmp_path / "empty").mkdir()
    assert command("train", *tiny(tmp_path / "run", f"init={tmp_path / where}")) == 2
    assert f"init={tmp_path / where}" in capsys.readouterr().err
