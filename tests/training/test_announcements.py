"""A training names what differs from the defaults, how it ended, and what to do next."""

from pathlib import Path

import pytest
from hydra import compose, initialize_config_module
from running import command, tiny

from gctd3.config.options import options
from gctd3.files import quoted
from gctd3.training.announcements import closing, differences, duration, opening, overruled

RUN = Path("runs/my run")
BEST = {
    "return_mean": 481.3,
    "return_std": 3.8,
    "success_rate": 1.0,
    "distance_mean": 15.0,
    "velocity_mean": 1.25,
    "frames": 60_000.0,
    "wall_s": 84.0,
}


@pytest.fixture
def config():
    """Compose a configuration of the training, as its command does."""

    def make(*overrides):
        return compose("config", list(overrides))

    with initialize_config_module("gctd3.conf", version_base="1.3"):
        yield make


@pytest.mark.nightly
def test_nothing_differs_from_the_defaults(config):
    assert list(differences(config())) == []
    assert "Differs" not in opening(config(), "walk", RUN)


def test_what_differs_is_named_with_its_default(config):
    asked = config("seed=3", "algo=td3", "reward.terms.height=null")
    assert set(differences(asked)) >= {"seed=3  (default 0)", "reward.terms.height=null"}
    assert all(line.startswith(("seed=", "reward.terms.height", "algo.", "network.")) for line in differences(asked))
    said = opening(asked, "walk", RUN)
    assert said.splitlines()[0] == "biped on walk: up to 600,000 frames of 64 robots, seed 3"
    assert f"Run directory: {quoted(RUN)}" in said and str(RUN / ".hydra" / "config.yaml") in said


@pytest.mark.parametrize(
    "line, named",
    [
        ("exploration=uniform", ["exploration=uniform holds but for", ": exploration.warmup=swinging"]),
        ("robot=go2 exploration=uniform", ["exploration=uniform holds but for", ": exploration.warmup=stepping"]),
        ("robot=go2 reward=paper", ["reward=paper holds but for", "reward.terms.progress=null", " more"]),
        ("robot=go2 stop_when=walk", ["stop_when.at_least.return_mean=null"]),
        # What holds, what the command line itself changes, and what others are meant to change.
        ("robot=go2 stop_when=never exploration=rhythmic", []),
        ("recipe=none exploration=uniform", []),
        ("exploration=uniform exploration.warmup=stepping", []),
        ("robot=go2 task=velocity terrain=rough", []),
        # The place of an option, the last of several, and keys that are given as a whole.
        ("robot=go2 reward@evaluation.reward=paper", []),
        ("robot=go2 stop_when=walk stop_when=never", []),
        (
            "robot=go2 stop_when=walk stop_when.at_least={} stop_when.at_most={} stop_when.restart_after=9",
            ["confirm=20"],
        ),
    ],
)
def test_an_option_that_robot_or_recipe_change_is_named(config, line, named):
    arguments = line.split()
    said = list(overruled(config(*arguments), arguments))
    assert len(said) == bool(named)
    assert all(words in said[0] for words in named)


@pytest.mark.nightly
@pytest.mark.parametrize("group", ["algo", "exploration", "network", "replay", "reward", "stop_when"])
def test_every_option_holds_where_nothing_else_is_brought(config, group):
    for option in options(group):
        arguments = [f"{group}={option}", "recipe=none"]
        assert list(overruled(config(*arguments), arguments)) == []


def test_a_wholly_different_task_does_not_fill_the_screen(config, monkeypatch):
    asked = config("task=walker2d", "algo=sac")
    different = list(differences(asked))
    monkeypatch.setattr("gctd3.training.announcements._MORE", 4)
    said = opening(asked, "walker2d", RUN).splitlines()
    assert said[2:6] == [f"  {line}" for line in different[:4]]
    assert said[6] == f"  and {len(different) - 4} more"


@pytest.mark.parametrize(
    "success, ended, expected, absent",
    [
        (1.0, True, ["Watch it walk"], ["does not walk", "Train it for longer"]),
        (0.6, True, ["does not walk in every episode yet", "total_frames=1200000", "seed=1"], ["Watch it walk"]),
        (0.0, True, ["It does not walk yet.", "Train it for longer", "See what it does"], ["Watch it walk"]),
        (0.0, False, ["It does not walk yet.", "See what it does"], ["Train it for longer", "Watch it walk"]),
    ],
)
def test_the_end_says_whether_it_walks_and_what_to_do(config, success, ended, expected, absent):
    said = closing({**BEST, "success_rate": success}, RUN, config(), True, ended)
    assert all(text in said for text in expected) and not any(text in said for text in absent)
    assert "after 60,000 frames and 1.4 minutes" in said and "'run=runs/my run'" in said


@pytest.mark.parametrize(
    ("followed", "falls", "expected", "absent"),
    [
        (0.95, 0.0, ["Steer it", "95% of the commands followed"], ["not follow", "longer", "Watch it walk"]),
        # A robot that stands never falls.
        (0.1, 0.0, ["does not follow all commands yet", "See what it does", "longer"], ["Watch it walk", "Steer it"]),
        (0.95, 0.1, ["does not follow all commands yet", "See what it does", "longer"], ["Watch it walk", "Steer it"]),
    ],
)
def test_a_robot_with_commands_is_judged_by_them(config, followed, falls, expected, absent):
    errors = {f"error_{axis}": 0.1 for axis in ("forward", "side", "turn")}
    best = {**BEST, **errors, "followed_rate": followed, "fall_rate": falls}
    said = closing(best, RUN, config(), True, True)
    assert all(text in said for text in expected) and not any(text in said for text in absent)


def test_a_librarys_task_has_no_walk(config):
    said = closing({**BEST, "distance_mean": 0.0}, RUN, config(), False, True)
    assert "walk" not in said and "success" not in said and "Evaluate it" in said
    assert closing(None, RUN, config(), True, True).strip().endswith("no best policy.")


@pytest.mark.parametrize("seconds, text", [(0.4, "0 s"), (11.7, "12 s"), (59.4, "59 s"), (84.0, "1.4 minutes")])
def test_short_times_are_in_seconds(seconds, text):
    assert duration(seconds) == text


def test_a_training_prints_no_yaml(tmp_path, capsys):
    assert command("train", *tiny(tmp_path / "run")) == 0
    out, err = capsys.readouterr()
    assert "_target_" not in out and len(out.splitlines()) < 45
    assert "Differs from the defaults:" in out and "  total_frames=240  (default 600_000)" in out
    # Without a terminal: a line for each of the three evaluations, and no bar.
    assert err.count(" of 240 frames, ") == 3 and "\r" not in err
