"""The benchmarks: tables of made-up rows, errors for wrong options, and trainings of the peers."""

import csv
import importlib
import json
import math
import os
import signal
import sys
import threading
import time
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
BENCHED = [
    "env_throughput",
    "inference_latency",
    "learner_throughput",
    "library_throughput",
    "peers",
    "robot_peers",
    "scale_out",
    "scaling",
    "ship_policy",
    "terrain_cost",
    "time_to_gait",
]


@pytest.fixture(autouse=True)
def _benchmarks_are_importable(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))


@pytest.fixture
def gait_table():
    return importlib.import_module("gait_table")


@pytest.fixture
def race():
    return importlib.import_module("time_to_gait")


def evaluation(success=1.0, reward=400.0, frames=100_000.0, distance=15.0):
    return {"frames": frames, "return_mean": reward, "success_rate": success, "distance_mean": distance}


def run(gait_table, contender, minutes, outcome="reached", seed=0, **row):
    return gait_table.Run(contender, seed, outcome, minutes, [evaluation(**row)])


@pytest.mark.parametrize("name", BENCHED)
def test_an_unknown_option_exits_with_the_accepted_ones(name, monkeypatch):
    benchmark = importlib.import_module(name)
    monkeypatch.setattr(sys, "argv", [f"{name}.py", "ouput=x.json", "--help"])
    with pytest.raises(SystemExit, match=r"^unknown ouput=x.json, --help; accepted: .*="):
        benchmark.main()


def test_a_walk_is_not_trained_where_one_is(tmp_path, monkeypatch):
    walk = importlib.import_module("walk")
    there = tmp_path / "gctd3" / "seed1"
    there.mkdir(parents=True)
    monkeypatch.setattr(sys, "argv", ["walk.py", "seeds=0,1", f"runs={tmp_path}", "total_frames=0"])
    with pytest.raises(SystemExit, match=f"^there is {there} already"):
        walk.main()
    assert not (tmp_path / "gctd3" / "seed0").exists()


@pytest.mark.parametrize(
    ("success", "reward", "passed"), [(1.0, 380.0, True), (1.0, 379.9, False), (0.8, 500.0, False), (0.0, -3.0, False)]
)
def test_a_walk_is_every_episode_at_the_finish_with_the_papers_return(gait_table, success, reward, passed):
    assert gait_table.passes(evaluation(success, reward)) is passed


def test_memory_is_compared_once_the_replay_is_full():
    memory = importlib.import_module("memory")
    # It fills up to 500 MB, then grows by 1 MB a sample.
    samples = [(i / 6, 1000 * i, min(500.0, 100.0 * i)) for i in range(10)]
    samples += [(i / 6, 1000 * i, 500.0 + i - 10) for i in range(10, 30)]
    assert memory.growth(samples, capacity=10_000) == (500.5, 518.5)
    with pytest.raises(SystemExit, match="full in 5 samples, of at least 10: train longer"):
        memory.growth(samples, capacity=25_000)


def test_resident_memory_is_what_python_itself_counts():
    usage = pytest.importorskip("resource").getrusage(0).ru_maxrss / 1e3  # kB, the maximum so far
    assert 0 < importlib.import_module("memory").resident(os.getpid()) < 1.1 * 1.024 * usage


def test_progress_is_read_up_to_its_last_whole_row(gait_table, tmp_path):
    file = tmp_path / "progress.csv"
    assert gait_table.read_progress(file) == []
    with file.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["frames", "return_mean", "stride_hz"])
        writer.writerow([20_000, 12.5, ""])
        writer.writerow([40_000, 13.5, "nan"])
        stream.write("60000,1")
    assert gait_table.read_progress(file) == [
        {"frames": 20_000.0, "return_mean": 12.5},
        {"frames": 40_000.0, "return_mean": 13.5},
    ]


def test_summary_counts_what_did_not_walk_as_longer_than_the_cap(gait_table):
    walked = [run(gait_table, "sb3", minutes, frames=frames) for minutes, frames in ((4.0, 1e5), (2.0, 3e5))]
    failed = run(gait_table, "sb3", 3.0, "failed")
    late = run(gait_table, "sb3", 20.0, "not within")

    both = gait_table.summary(walked, 20.0)
    assert (both.reached, both.all, both.median, both.min, both.max) == (2, 2, 3.0, 2.0, 4.0)
    assert (both.bounds, both.frames) == ([], 2e5)
    # 2, 4, > 20: the middle one is known.
    three = gait_table.summary([*walked, failed], 20.0)
    assert (three.reached, three.median, three.bounds) == (2, 4.0, ["max"])
    # 2, 4, > 20, > 20: the middle is (4 + more than 20) / 2.
    four = gait_table.summary([*walked, failed, late], 20.0)
    assert (four.median, four.bounds) == (12.0, ["median", "max"])
    none = gait_table.summary([late], 20.0)
    assert (none.reached, none.minutes("median"), none.minutes("min"), none.frames) == (0, ">20.0", ">20.0", None)


def test_ratio_is_of_medians_and_a_bound_where_they_are(gait_table):
    base = gait_table.summary([run(gait_table, "gctd3", 4.0)], 20.0)
    known = gait_table.summary([run(gait_table, "td3", 6.0)], 20.0)
    late = gait_table.summary([run(gait_table, "sb3", 20.0, "not within")], 20.0)
    assert [gait_table.ratio(x, base) for x in (base, known, late)] == ["1.0", "1.5", ">5.0"]
    assert gait_table.ratio(known, late) == "-"
    assert gait_table.ratio(known, None) == "-"


def test_table_names_every_run_that_did_not_walk(gait_table):
    runs = [
        run(gait_table, "gctd3", 4.0),
        run(gait_table, "gctd3", 6.0, seed=1),
        run(gait_table, "sb3", 20.0, "not within", success=0.2, reward=55.5, distance=3.2),
        gait_table.Run("sbx", 0, "failed", 0.1, exit_code=3),
    ]
    runs[2].curve.append(evaluation(0.0, 90.0))
    lines = gait_table.table(runs, 20.0).splitlines()
    assert lines[1].split() == ["gctd3", "2/2", "5.0", "4.0", "6.0", "100,000", "1.0"]
    assert lines[2].split() == ["sb3", "0/1", ">20.0", ">20.0", ">20.0", "-", ">4.0"]
    assert lines[4:] == [
        "sb3 seed 0: not within 20 min; best: 100,000 steps, return 55.5, success 20%, 3.2 m",
        "sbx seed 0: failed with exit code 3 after 0.1 min, see its log.txt; never evaluated",
    ]


def test_plan_takes_turns_and_names_who_is_not_installed(race, monkeypatch):
    monkeypatch.setattr(race, "installed", lambda peer: peer != "sbx")
    runs, missing = race.plan({"contenders": "gctd3,sb3,sbx", "seeds": "0,1", "our_seeds": "5,6,7"})
    assert [(r.contender, r.seed) for r in runs] == [("gctd3", 5), ("sb3", 0), ("gctd3", 6), ("sb3", 1), ("gctd3", 7)]
    assert missing == ["sbx: sbx is not installed"]
    with pytest.raises(SystemExit, match="no contender ppo; there are gctd3, td3, torchrl, sb3, sbx"):
        race.plan({"contenders": "gctd3,ppo", "seeds": "0", "our_seeds": ""})


# A stand-in for a training: it writes the given rows, then stays or ends.
STAND_IN = """
import pathlib, sys, time
rows, code = sys.argv[2].split(";"), int(sys.argv[3])
file = pathlib.Path(sys.argv[1], "progress.csv")
file.write_text("frames,return_mean,success_rate,distance_mean\\n" + "".join(row + "\\n" for row in rows if row))
time.sleep(0 if code >= 0 else 600)
sys.exit(code)
"""


@pytest.mark.parametrize(
    ("rows", "code", "cap", "outcome", "seen"),
    [
        ("20000,50,0.2,3;40000,400,1,15;60000,410,1,15", -1, 1.0, "reached", 2),
        ("20000,50,0.2,3", -1, 0.01, "not within", 1),
        ("20000,50,0.2,3", 0, 1.0, "ended", 1),
        ("", 3, 1.0, "failed", 0),
    ],
)
def test_race_ends_when_it_walks_or_its_time_is_up(race, tmp_path, capsys, rows, code, cap, outcome, seen):
    racer, directory = race.Run("gctd3", 0), tmp_path / "run"
    line = [sys.executable, "-c", STAND_IN, str(directory), rows, str(code)]
    race.race(racer, line, directory, cap, 1, threading.Event())
    assert (racer.outcome, len(racer.curve)) == (outcome, seen)
    assert racer.exit_code == (code if code >= 0 else None)
    assert 0 < racer.minutes < 1
    assert capsys.readouterr().out.count("gctd3 seed 0: ") == seen + 1


def test_an_interrupt_ends_the_trainings_and_reports_what_was_over(race, tmp_path, monkeypatch, capsys):
    """An interrupt in the second training ends it, and the finished first one is reported."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    pid, out = tmp_path / "pid", tmp_path / "out.json"
    stays = f"import os, pathlib, time; pathlib.Path({str(pid)!r}).write_text(str(os.getpid())); time.sleep(600)"

    def command(contender, seed, directory, *_):
        walks = ["-c", STAND_IN, str(directory), "40000,400,1,15", "-1"]
        return [sys.executable, *(walks if seed == 0 else ["-c", stays])]

    def kill():
        deadline = time.monotonic() + 30
        while not (pid.exists() and pid.read_text()) and time.monotonic() < deadline:
            time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr(race, "command", command)
    arguments = ["contenders=td3", "seeds=0,1,2", f"runs={tmp_path / 'runs'}", f"out={out}"]
    monkeypatch.setattr(sys, "argv", ["time_to_gait.py", *arguments])
    killer = threading.Thread(target=kill)
    killer.start()
    try:
        with pytest.raises(SystemExit) as end:
            race.main()
    finally:
        killer.join()
        for number, handler in handlers.items():
            signal.signal(number, handler)
    assert end.value.code == 130
    with pytest.raises(ProcessLookupError):
        os.kill(int(pid.read_text()), 0)
    written = json.loads(out.read_text())
    assert [(r["seed"], r["outcome"]) for r in written["runs"]] == [(0, "reached")]
    assert written["interrupted"] is True
    assert (written["summary"]["td3"]["reached"], written["summary"]["td3"]["all"]) == (1, 1)
    assert str(tmp_path) not in out.read_text()
    assert "Interrupted; what has ended is reported." in capsys.readouterr().out


def test_peers_are_evaluated_for_the_default_trainings_rewards():
    settings = importlib.import_module("peers").shared_settings("evaluation.every=123", "evaluation.episodes=5")
    assert settings.reward.terms["living"].weight == 0.5
    assert (settings.evaluation.every, settings.evaluation.episodes) == (123, 5)
    assert settings.evaluation.reward.terms["living"].weight == -0.1


@pytest.mark.nightly
def test_stock_torchrl_trains_and_is_evaluated(tmp_path):
    peers = importlib.import_module("peers")
    evaluator = peers.Evaluator(
        peers.shared_settings("evaluation.every=100", "evaluation.episodes=2"), tmp_path, minutes=1.0, threads=1
    )
    recipe = peers.StockRecipe(init_random_frames=100, frames_per_batch=50, size=300, batch_size=16, prefetch=0)
    peers.stock_torchrl(evaluator, 0, recipe, total_frames=200)
    rows = importlib.import_module("gait_table").read_progress(tmp_path / "progress.csv")
    # Learning starts with the batch that completes the random frames.
    assert [(row["frames"], row["updates"]) for row in rows] == [(100, 50), (200, 150)]
    assert all(math.isfinite(row["return_mean"]) for row in rows)
    assert json.loads((tmp_path / "recipe.json").read_text())["batch_size"] == 16


@pytest.mark.nightly
def test_stable_baselines3_trains_and_is_evaluated(tmp_path):
    pytest.importorskip("stable_baselines3")
    peers = importlib.import_module("peers")
    evaluator = peers.Evaluator(
        peers.shared_settings("evaluation.every=110", "evaluation.episodes=2"), tmp_path, minutes=0.05, threads=1
    )
    peers.stable_baselines("sb3", "td3", evaluator, 0)
    row = importlib.import_module("gait_table").read_progress(tmp_path / "progress.csv")[0]
    # The first 100 steps are random.
    assert (row["frames"], row["updates"]) == (110, 9)


def test_scaling_sizes_and_graphs():
    scaling = importlib.import_module("scaling")
    assert [scaling.doublings(n) for n in (1, 2, 6, 8)] == [[1], [1, 2], [1, 2, 4, 6], [1, 2, 4, 8]]
    tree = scaling.random_tree(16)
    assert (tree.num_nodes, len(tree.edges)) == (16, 15)
    assert scaling.per_robot({"a": {4: 2.0}}) == {"a": {4: 500.0}}


def test_latency_times_every_call_and_takes_the_ways_in_turn():
    latency = importlib.import_module("inference_latency")
    calls = []
    work = {name: lambda i, name=name: calls.append((name, i)) for name in ("a", "b")}
    times = latency.measure(work, calls=6, rounds=2)
    assert {name: len(values) for name, values in times.items()} == {"a": 6, "b": 6}
    warm = latency.WARM_UP
    assert calls[: 2 * warm] == [("a", i) for i in range(warm)] + [("b", i) for i in range(warm)]
    assert calls[2 * warm :] == [(name, warm + 3 * turn + i) for turn in (0, 1) for name in "ab" for i in range(3)]
    # 1 to 101: the median is 51, and a hundredth of the way from 101 back is 100.
    found = latency.percentiles([float(x) for x in range(1, 102)])
    assert found == {"p50": 51.0, "p99": pytest.approx(100.0), "max": 101.0}
