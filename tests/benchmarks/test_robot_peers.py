"""Minutes until a robot walks, beside other libraries: criteria, ratios, going on after a stop, small trainings."""

import importlib
import json
import math
import sys
import threading
from dataclasses import asdict
from pathlib import Path

import gymnasium
import pytest

from gctd3.training.stop_when import StopWhen

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
RULE = StopWhen(at_least={"success_rate": 1.0, "periodic_fraction": 0.9}, at_most={"slip_speed": 0.12}, evaluations=2)
NOTHING = {"settings": "", "own": "", "again": "", "parallel": "", "seeds": "0"}
NOTHING |= {"cap": "20", "seconds": "20", "threads": "2"}


@pytest.fixture(autouse=True)
def _benchmarks_are_importable(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))


@pytest.fixture
def bench():
    return importlib.import_module("robot_peers")


@pytest.fixture
def peers():
    return importlib.import_module("peers")


def seen(minutes, success=1.0, **more):
    """Return an evaluation."""
    row = {"frames": 1000 * minutes, "return_mean": 1.0, "success_rate": success, "distance_mean": 15 * success}
    return {**row, "minutes": float(minutes), **more}


GOOD = {"periodic_fraction": 1.0, "slip_speed": 0.05}
SLIDES = {"periodic_fraction": 1.0, "slip_speed": 0.5}


def made(bench, contender, curve, outcome="reached", minutes=None, seed=0):
    """Return a run."""
    return bench.Run(contender, seed, outcome, curve[-1]["minutes"] if minutes is None else minutes, curve)


def test_a_robot_walks_if_it_meets_all_conditions_so_many_times_in_a_row(bench):
    walks = bench.walking(RULE)
    curve = [
        seen(1, **GOOD),
        seen(2, **SLIDES),
        seen(3, **GOOD),
        seen(4, 0.9, **GOOD),
        seen(5, **GOOD),
        seen(6, **GOOD),
    ]
    assert [walks(curve[:i]) for i in range(1, 7)] == [False] * 5 + [True]
    assert [bench.arrives(curve[:i]) for i in range(1, 7)] == [True, True, True, False, True, True]
    # Arrived somehow, of which no gait is known.
    assert not walks([seen(1), seen(2)])


def test_of_a_commanded_velocity_commands_are_followed(bench):
    """Standing for the whole episode is a success there, and no arrival; nor do falls prevent one."""
    stands = seen(1, followed_rate=0.3, fall_rate=0.0, error_side=0.2)
    curve = [stands, seen(2, 0.8, followed_rate=0.91, fall_rate=0.2), seen(3, followed_rate=0.97, fall_rate=0.0)]
    assert [bench.arrives(curve[:i]) for i in (1, 2, 3)] == [False, True, True]
    rule = StopWhen(at_least={"followed_rate": 0.95}, at_most={"fall_rate": 0.0}, evaluations=1)
    assert [bench.walking(rule)(curve[:i]) for i in (1, 2, 3)] == [False, False, True]
    found = bench.results([made(bench, "sb3-sac x64", curve)], 20.0, rule)["sb3-sac x64"]
    assert found.arrival.minutes("median") == "2.0" and found.walk.minutes("median") == "3.0"
    assert bench.gait_words(found).startswith("91% of the commands followed, falls 20%; misses followed_rate 0.91 <")


def test_conditions_that_are_missed_are_named(bench):
    assert RULE.missed(seen(1, **GOOD)) == []
    assert RULE.missed(seen(1, 0.5, slip_speed=0.5)) == [
        "success_rate 0.5 < 1",
        "periodic_fraction undefined",
        "slip_speed 0.5 > 0.12",
    ]


def test_times_are_over_the_whole_command_and_caps_are_longer_than(bench):
    runs = [
        # It arrives after 2 minutes, and its command ends after 4.
        made(bench, "gctd3 x64", [seen(2, **SLIDES), seen(3, **GOOD), seen(3.5, **GOOD)], minutes=4.0),
        made(bench, "sb3-td3 x1", [seen(6, 0.2), seen(19, 0.4, **SLIDES)], "not within", minutes=20.0),
        made(bench, "sbx-sac x64", [seen(6, **SLIDES), seen(19, **SLIDES)], "not within", minutes=20.0),
        made(bench, "sbx-ppo x64", [seen(8, **SLIDES), seen(10, **GOOD), seen(12, **GOOD)]),
        bench.Run("sb3-ppo x1", 0, "failed", 0.1, exit_code=3),
    ]
    found = bench.results(runs, 20.0, RULE)
    assert {name: (one.arrival.minutes("median"), one.arrival_ratio) for name, one in found.items()} == {
        "gctd3 x64": ("2.0", "0.5"),
        "sb3-td3 x1": (">20.0", ">5.0"),
        "sbx-sac x64": ("6.0", "1.5"),
        "sbx-ppo x64": ("8.0", "2.0"),
        "sb3-ppo x1": (">20.0", ">5.0"),
    }
    assert {name: (one.walk.minutes("median"), one.walk_ratio) for name, one in found.items()} == {
        "gctd3 x64": ("4.0", "1.0"),
        "sb3-td3 x1": (">20.0", ">5.0"),
        "sbx-sac x64": (">20.0", ">5.0"),
        "sbx-ppo x64": ("12.0", "3.0"),
        "sb3-ppo x1": (">20.0", ">5.0"),
    }
    assert bench.best_peer(found) == "sbx-sac x64"
    assert found["sbx-sac x64"].missed == ["slip_speed 0.5 > 0.12"]
    # Who never arrived is shown where most episodes did.
    assert found["sb3-td3 x1"].at["minutes"] == 19.0 and found["sb3-ppo x1"].at is None
    lines = bench.table(found, runs, 20.0).splitlines()
    assert lines[3].split() == ["sbx-sac", "x64", "1/1", "6.0", "1.5", "0/1", ">20.0", ">5.0", "6,000"]
    assert any(line.startswith("sb3-ppo x1 seed 0: failed with exit code 3") for line in lines)
    assert "of the others, sbx-sac x64 arrives first" in lines
    json.dumps({name: asdict(one) for name, one in found.items()}, allow_nan=False)


def test_without_a_walk_of_ours_there_is_no_ratio(bench):
    runs = [made(bench, "gctd3 x64", [seen(19, 0.5)], "not within", 20.0), made(bench, "sb3-td3 x1", [seen(6)])]
    found = bench.results(runs, 20.0, RULE)
    assert found["sb3-td3 x1"].arrival_ratio == "-" and found["gctd3 x64"].walk.minutes("median") == ">20.0"


def test_plan_has_ours_once_and_the_others_on_one_robot_and_on_as_many(bench, monkeypatch):
    monkeypatch.setattr(bench, "installed", lambda peer: not peer.startswith("sbx"))
    given = {**NOTHING, "peers": "gctd3,sb3-td3,sbx-sac", "seeds": "0,1"}
    cells, missing = bench.plan(given, 64)
    assert [(c.peer, c.robots, c.seed) for c in cells] == [
        (peer, robots, seed) for seed in (0, 1) for peer, robots in (("gctd3", 64), ("sb3-td3", 1), ("sb3-td3", 64))
    ]
    assert missing == ["sbx-sac is not installed"]
    assert [c.robots for c in bench.plan({**given, "parallel": "8", "peers": "sb3-ppo"}, 64)[0]] == [8, 8]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"peers": "gctd3,ppo"}, "peers knows no ppo; there are gctd3, sb3-td3, sb3-sac"),
        ({"parallel": "0"}, "parallel and threads must be at least 1"),
        ({"cap": "0"}, "cap and seconds above 0"),
        ({"again": "yes"}, "again must be none, failed, all or nothing, got yes"),
    ],
)
def test_wrong_options_are_refused(bench, change, said):
    with pytest.raises(SystemExit, match=said):
        bench.plan({**NOTHING, "peers": "gctd3", **change}, 64)


def test_peers_are_named_by_library_and_algorithm(peers):
    assert [peers.parts(name) for name in ("sb3", "sbx-sac", "torchrl")] == [
        ("sb3", "td3"),
        ("sbx", "sac"),
        ("torchrl", "td3"),
    ]
    with pytest.raises(SystemExit, match=r"peer must be one of torchrl, sb3, sb3-td3, .*, got torchrl-sac"):
        peers.parts("torchrl-sac")


@pytest.mark.parametrize(("robot", "more"), [("biped", []), ("quadruped", []), ("quadruped", ["task=velocity"])])
def test_peers_train_on_the_task_and_reward_of_the_command(peers, robot, more):
    settings = peers.shared_settings(f"robot={robot}", *more)
    task, theirs = settings.setup().task, peers.make_env(settings).unwrapped._one.simulation.task
    assert theirs.reward == task.reward == settings.reward
    assert theirs.settings == task.settings
    assert theirs.graph.nodes == task.graph.nodes and theirs.history == task.history
    assert theirs.control_dt == task.control_dt


# A stand-in for a training: it writes two evaluations, and ends a moment later.
ENDS = """
import pathlib, sys, time
head = "frames,return_mean,success_rate,distance_mean,evaluating_s\\n"
pathlib.Path(sys.argv[1], "progress.csv").write_text(head + "100,1,1,15,0.1\\n200,1,1,15,0.2\\n")
time.sleep(0.7)
"""


@pytest.mark.parametrize(("whole", "rows"), [(True, 2), (False, 1)])
def test_a_whole_command_is_timed_to_its_end_without_evaluations_that_do_not_count(bench, tmp_path, whole, rows):
    run, line = bench.Run("gctd3 x64", 0), [sys.executable, "-c", ENDS, str(tmp_path / "run")]
    bench.race(run, line, tmp_path / "run", 1.0, 1, threading.Event(), walks=bench.arrives, whole=whole)
    assert (run.outcome, len(run.curve)) == ("reached", rows)
    assert run.exit_code == (0 if whole else None)
    if whole:
        first, second = run.curve
        # Both are read at once; the second one's evaluations have taken 0.1 s longer.
        assert 60 * (first["minutes"] - second["minutes"]) == pytest.approx(0.1, abs=1e-6)
        assert 60 * (run.minutes - second["minutes"]) > 0.4


def test_a_running_evaluation_does_not_use_up_the_cap(bench, peers, tmp_path):
    assert peers.evaluating(tmp_path) == 0.0
    (tmp_path / peers.MARK).touch()
    assert 0.0 <= peers.evaluating(tmp_path) < 5.0
    # Its mark lies there for 0.8 s, longer than the cap of 0.6 s.
    evaluates = f"""
import pathlib, sys, time
mark = pathlib.Path(sys.argv[1], {peers.MARK!r})
mark.touch()
time.sleep(0.8)
head = "frames,return_mean,success_rate,distance_mean,evaluating_s\\n"
pathlib.Path(sys.argv[1], "progress.csv").write_text(head + "100,1,1,15,0.8\\n")
mark.unlink()
time.sleep(60)
"""
    run = bench.Run("sb3-td3 x1", 0)
    line = [sys.executable, "-S", "-c", evaluates, str(tmp_path / "run")]
    bench.race(run, line, tmp_path / "run", 0.01, 1, threading.Event(), walks=bench.arrives)
    assert run.outcome == "reached" and run.minutes < 0.01


def test_what_is_over_is_not_trained_again(bench, tmp_path, monkeypatch, capsys):
    trained = []

    def train(cell, *_):
        trained.append(cell.title)
        return bench.Run(cell.contender, cell.seed, "failed", 1.0, exit_code=1)

    monkeypatch.setattr(bench, "train", train)
    out = tmp_path / "out.json"

    def call(*more):
        trained.clear()
        arguments = ["robot=quadruped", "peers=gctd3,sb3-td3", "parallel=1,4", f"runs={tmp_path}", f"out={out}", *more]
        monkeypatch.setattr(sys, "argv", ["robot_peers.py", *arguments])
        bench.main()
        return list(trained)

    monkeypatch.setattr(bench, "installed", lambda peer: True)
    titles = ["gctd3_64_seed0", "sb3-td3_1_seed0", "sb3-td3_4_seed0"]
    assert call() == titles
    assert call() == []
    (tmp_path / "quadruped" / "sb3-td3_1_seed0.json").unlink()
    assert call("again=none") == []
    held = json.loads(out.read_text())
    assert held["not_measured"] == ["sb3-td3 x1 seed 0 has not been trained"]
    assert list(held["summary"]) == ["gctd3 x64", "sb3-td3 x4"]
    said = capsys.readouterr().out
    assert "0 trainings of at most 20 min, 3 known" in said
    assert "not measured: sb3-td3 x1 seed 0 has not been trained" in said
    assert call() == ["sb3-td3_1_seed0"]
    assert call("again=failed") == titles
    with pytest.raises(SystemExit, match="was made with cap=20: choose another runs=, or the same options"):
        call("cap=5")
    written = json.loads(out.read_text())
    assert [run["outcome"] for run in written["runs"]] == ["failed"] * 3
    assert written["summary"]["sb3-td3 x4"]["arrival"]["bounds"] == ["median", "min", "max"]
    assert written["criterion"]["walks"]["evaluations"] >= 1
    assert str(tmp_path) not in out.read_text()


@pytest.mark.nightly
@pytest.mark.parametrize("robots", [1, 4])
@pytest.mark.parametrize("algorithm", ["td3", "sac", "ppo"])
@pytest.mark.parametrize("library", ["sb3", "sbx"])
def test_each_algorithm_trains_and_is_evaluated(peers, tmp_path, library, algorithm, robots):
    pytest.importorskip(peers.PACKAGES[library])
    settings = peers.shared_settings(
        "robot=quadruped", "evaluation.episodes=2", "task.terminations.time_limit.steps=20"
    )
    minutes = 0.02
    evaluator = peers.Evaluator(settings, tmp_path, minutes, threads=1, seconds=0.5)
    peers.stable_baselines(library, algorithm, evaluator, 0, robots, updates=-1)
    rows = importlib.import_module("gait_table").read_progress(tmp_path / "progress.csv")
    assert rows and all(math.isfinite(row["return_mean"]) and row["frames"] % robots == 0 for row in rows)
    assert all(row[peers.EVALUATING] > 0 for row in rows) and not (tmp_path / peers.MARK).exists()
    recipe = json.loads((tmp_path / "recipe.json").read_text())
    assert recipe["robots"] == robots
    if algorithm == "ppo":
        assert recipe["n_steps"] * robots == 2048
    else:
        assert recipe["gradient_steps"] == (1 if robots == 1 else -1)


@pytest.mark.nightly
def test_a_small_comparison_by_the_command(bench, tmp_path, monkeypatch):
    pytest.importorskip("stable_baselines3")
    out = tmp_path / "out.json"
    arguments = ["robot=quadruped", "peers=sb3-td3", "parallel=2", "cap=0.6", "seconds=2", "threads=1"]
    monkeypatch.setattr(sys, "argv", ["robot_peers.py", *arguments, f"runs={tmp_path / 'runs'}", f"out={out}"])
    bench.main()
    (run,) = json.loads(out.read_text())["runs"]
    assert (run["outcome"], run["recipe"]["robots"]) == ("not within", 2)
    assert run["curve"] and run["curve"][0]["minutes"] < 0.6


def test_gymnasiums_vector_environment_is_what_several_robots_are(peers):
    pytest.importorskip("stable_baselines3")
    settings = peers.shared_settings("robot=quadruped")
    several = peers.make_robots(settings, 3, 1)
    one = gymnasium.make("gctd3/Biped-v0", robot="quadruped", reward="walk")
    assert several.num_envs == 3 and several.observation_space == one.observation_space
    assert several.reset().shape == (3, *one.observation_space.shape)
