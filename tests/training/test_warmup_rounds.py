"""A warm-up in rounds: it ends once its fittest gait succeeds, and a run that was stopped in it goes on alike."""

import json
from pathlib import Path

import pytest
from finished import BRIEF
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf
from resuming import assert_same_run, stopped
from running import Recorded, command, rows, tiny, train

from gctd3.training.evaluations import Evaluations

# Two rounds of 10 of 20 control steps, of four robots.
ROUNDS = [
    BRIEF,
    "robot=quadruped",
    "replay.n_step=1",
    "exploration.rounds=2",
    "exploration.gait_time=0.04",
    "exploration.from_standing=true",
    "imitation.updates=3",
    "imitation.critics_first=2",
    "stop_when.confirm=2",
    "stop_when.evaluations=9",
]
# Conditions that each gait meets, and that none does.
OTHERS = ("velocity_mean", "stride_hz", "periodic_fraction", "height_from_home")
FREED = ["~stop_when.at_most", *(f"stop_when.at_least.{name}=null" for name in OTHERS)]
ANY, NONE = ([*FREED, f"stop_when.at_least.success_rate={share}"] for share in (0, 1))


def updates(run):
    return {int(row["frames"]): int(row["updates"]) for row in rows(run)}


def test_a_gait_that_succeeds_ends_the_warm_up(tmp_path, capsys):
    run = train(tmp_path, *ROUNDS, *ANY)
    said = capsys.readouterr().out
    assert "The fittest gait of the warm-up" in said and "misses" not in said
    # The policy begins as the gait, and is evaluated, at the first batch after the round.
    first, *others = updates(run)
    assert 40 <= first < 80 and others
    assert updates(run)[first] > 0
    assert json.loads((run / "warmup_gait.json").read_text())["episodes"] == 2


def test_gaits_evolve_on_where_none_succeeds(tmp_path, capsys):
    run = train(tmp_path, *ROUNDS, *NONE)
    said = capsys.readouterr().out
    # After either round.
    assert said.count("It misses success_rate 0 < 1.") == 2 and said.count("The policy begins as") == 1
    assert min(updates(run)) == 80
    # Of the last round, whether it succeeds or not.
    assert (run / "warmup_gait.json").is_file()


def test_a_gait_that_is_less_fit_but_meets_the_conditions_is_preferred(tmp_path, capsys, monkeypatch):
    """End the warm-up with the second one of the last gaits, and begin the policy as that one."""
    measured = Evaluations._measure_gait
    tried = []

    def measure(self, gaits):
        tried.append((gaits.finalists, gaits._fittest(1)["stride"].tolist()))
        return {**measured(self, gaits), "success_rate": float(len(tried) > 1) - 1.0}

    monkeypatch.setattr(Evaluations, "_measure_gait", measure)
    run = train(tmp_path, *ROUNDS, *ANY)
    assert "misses" not in capsys.readouterr().out and min(updates(run)) < 80
    (first, _), (second, begun) = tried
    gaits = Recorded.last.explorer.rhythm
    assert first == second and int(gaits.chosen) == first[1]
    assert gaits._fittest(1)["stride"].tolist() == begun
    assert gaits.finalist[gaits.followers].tolist() == [first[1]] * int(gaits.followers.sum())


def test_of_gaits_that_all_miss_conditions_the_best_one_is_taken(tmp_path, capsys, monkeypatch):
    """None of the last gaits succeeds, and the policy begins as the one with the best return, not as the fittest."""
    measured = Evaluations._measure_gait
    tried = []

    def measure(self, gaits):
        tried.append(int(gaits.chosen))
        return {**measured(self, gaits), "return_mean": float(len(tried))}

    monkeypatch.setattr(Evaluations, "_measure_gait", measure)
    train(tmp_path, *ROUNDS, *NONE)
    assert capsys.readouterr().out.count("It misses success_rate 0 < 1.") == 2
    gaits = Recorded.last.explorer.rhythm
    # Whoever was evaluated last had the best return.
    assert len(gaits.finalists) > 1 and int(gaits.chosen) == tried[-1] == gaits.finalists[-1] != gaits.finalists[0]


def test_gaits_evolve_on_if_the_policy_that_begins_as_one_fails(tmp_path, capsys, monkeypatch):
    """From other starts the policy misses what it met; a new one begins as the fittest gait of the other round."""
    speeds = iter([-200.0, 0.0])

    def again(*_):
        return {"return_mean": 0.0, "success_rate": 0.0, "velocity_mean": next(speeds)}

    monkeypatch.setattr("gctd3.training.evaluations.confirm", again)
    run = train(tmp_path, *ROUNDS, *ANY, "stop_when.at_least.velocity_mean=-100", "stop_when.evaluations=1")
    said = capsys.readouterr().out
    assert said.count("The policy begins as") == 2 and said.count("Gaits evolve on; the best policy is kept.") == 1
    first, second = rows(run)
    assert (float(first["confirmed"]), float(second["confirmed"])) == (0.0, 1.0)
    assert 40 <= int(first["frames"]) < 80 <= int(second["frames"])


def test_trainings_that_nothing_ends_have_equal_warm_ups(tmp_path, capsys):
    """Comparisons give every policy one round, whatever its gaits do."""
    run = train(tmp_path, *ROUNDS, *NONE, "stop_when.evaluations=null")
    assert "It misses" not in capsys.readouterr().out
    assert min(updates(run)) == 40


def test_a_warm_up_leaves_frames_to_learn_in(tmp_path, capsys):
    """Rounds end where another one would take what is left."""
    run = train(tmp_path, *ROUNDS, *NONE, "exploration.rounds=4", "exploration.learning_starts=320", "total_frames=240")
    assert capsys.readouterr().out.count("It misses") == 2
    assert min(updates(run)) == 160


def test_a_first_round_beyond_the_last_frame_is_refused(tmp_path, capsys):
    line = [*ROUNDS, "exploration.learning_starts=600"]
    assert command("train", *tiny(tmp_path / "run", *line, without=["exploration.learning_starts"])) == 2
    said = capsys.readouterr().err
    assert "must be at most total_frames = 240, got 600, 300 of them in the first of 2 rounds" in said
    assert not (tmp_path / "run").exists()


@pytest.mark.nightly
@pytest.mark.parametrize(("bound", "frames"), [(ANY, 64), (NONE, 64), (NONE, 40)])
def test_stopped_after_a_round(tmp_path, bound, frames):
    settings = [*ROUNDS, *bound]
    whole = train(tmp_path / "whole", *settings)
    part = stopped(tmp_path / "part", frames, *settings)
    assert command("train", f"resume={part}") == 0
    assert_same_run(whole, part)


@pytest.mark.nightly
def test_stopped_in_a_round_that_follows_a_policy(tmp_path, monkeypatch):
    """The policy of the first round misses from other starts what it met; the run is stopped in the second round."""
    speeds = iter([-200.0, 0.0, -200.0, 0.0])

    def again(*_):
        return {"return_mean": 0.0, "success_rate": 0.0, "velocity_mean": next(speeds)}

    monkeypatch.setattr("gctd3.training.evaluations.confirm", again)
    settings = [*ROUNDS, *ANY, "stop_when.at_least.velocity_mean=-100", "stop_when.evaluations=1"]
    whole = train(tmp_path / "whole", *settings)
    part = stopped(tmp_path / "part", 64, *settings)
    assert len(rows(part)) == 1
    assert command("train", f"resume={part}") == 0
    assert_same_run(whole, part)


def test_robots_with_free_bases_have_rounds_as_long_as_a_search():
    """Every robot's rounds hold four trials of each robot, or more."""
    robots = sorted(path.stem for path in (Path(__file__).parents[2] / "conf/robot").glob("*.yaml"))
    seen = set()
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        for robot in [name for name in robots if name not in ("free", "free_biped")]:
            config = compose("config", [f"robot={robot}"])
            exploration, robots_at_once = OmegaConf.to_container(config.exploration), config.env.num_envs
            rounds = exploration.get("rounds", 1)
            if rounds > 1:
                assert exploration["learning_starts"] / rounds / robots_at_once * 0.02 / 4.0 > 4.0, robot
                seen.add(robot)
    assert {"go2", "g1", "quadruped"} <= seen
