"""benchmarks/whole_command.py: what counts as a failure, the ratios, and that each tree's own package runs."""

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
GAIT = {"stride_hz": 1.7, "hip_correlation": -0.9, "flight_fraction": 0.2}


@pytest.fixture
def whole(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module("whole_command")


def training(build, seed, seconds, memory=500.0, **changed):
    evaluation = {"success_rate": 1.0, "return_mean": 450.0, "velocity_mean": 1.1, "gait": GAIT, **changed}
    return {"build": build, "seed": seed, "seconds": seconds, "memory_mb": memory, "evaluation": evaluation}


def test_a_policy_has_to_walk_from_every_start(whole):
    assert whole.missed(training("new", 0, 20.0), "algo=gctd3") == []
    slow = training("new", 0, 20.0, success_rate=0.98, gait={**GAIT, "flight_fraction": 0.41})
    assert whole.missed(slow, "algo=gctd3") == ["success_rate 0.98 < 1.0", "flight_fraction 0.41 > 0.4"]
    # Without a stride there is no gait: both bounds of its frequency, hips, and the time in the air.
    assert len(whole.missed(training("new", 0, 20.0, gait={}), "algo=gctd3")) == 4
    assert whole.missed({"build": "new", "seed": 0, "exit_code": -9}, "algo=gctd3") == ["exit code -9"]


def test_the_faster_policy_has_to_exceed_both_numbers(whole):
    fast = "experiment=table5_best"
    assert whole.missed(training("new", 0, 20.0), fast) == ["velocity_mean 1.1 < 1.414"]
    assert whole.missed(training("new", 0, 20.0, velocity_mean=1.42), fast) == []


def test_builds_are_compared_over_the_seeds_that_both_have(whole):
    old = [training("old", seed, seconds) for seed, seconds in ((0, 90.0), (1, 60.0), (2, 300.0), (3, 50.0))]
    new = [training("new", seed, s, memory=300.0) for seed, s in ((0, 30.0), (1, 30.0), (2, 60.0))]
    new[1]["evaluation"]["velocity_mean"] = 0.9
    result = whole.compare([*old, *new], [0, 1, 2, 3], "algo=gctd3")
    assert result["seeds"] == 3 and result["new"]["failed"] == {"1": ["velocity_mean 0.9 < 1.0"]}
    # Medians of 90, 60, 300 and of 30, 30, 60; the longest; seed by seed 1/3, 1/2, 1/5.
    assert result["median_s_ratio"] == pytest.approx(30 / 90)
    assert result["longest_s_ratio"] == pytest.approx(60 / 300)
    assert result["memory_mb_ratio"] == pytest.approx(0.6)
    assert result["ratio_by_seed"] == pytest.approx({"median": 1 / 3, "least": 1 / 5, "most": 1 / 2})
    text = whole.table({"tuned": result, "untuned": whole.compare([], [101], "algo=gctd3")})
    assert "1: velocity_mean 0.9 < 1.0" in text and "median 0.33, longest 0.20" in text and "untuned" not in text


def test_each_build_runs_its_own_tree(whole, tmp_path):
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "sitecustomize.py").write_text(whole.SITE)
    tree = tmp_path / "tree"
    for package in ("gctd3", "conf", "models"):
        (tree / package).mkdir(parents=True)
        (tree / package / "__init__.py").write_text(f"HERE = {package!r}")
    build = whole.Build("old", tree, tmp_path / "site")
    code = "import gctd3, gctd3.conf, gctd3.models; print(gctd3.HERE, gctd3.conf.HERE, gctd3.models.HERE)"
    shown = subprocess.run([sys.executable, "-c", code], env=build.env, capture_output=True, text=True, check=True)
    assert shown.stdout.split() == ["gctd3", "conf", "models"]


def test_a_command_that_takes_too_long_is_ended(whole, tmp_path):
    site = tmp_path / "site"
    site.mkdir()
    (site / "sitecustomize.py").write_text(whole.SITE)
    tree = tmp_path / "tree" / "gctd3"
    tree.mkdir(parents=True)
    (tree / "__init__.py").write_text("")
    (tree / "train.py").write_text("import time\ntime.sleep(60)")
    (tree / "graph.py").write_text("held = bytearray(50_000_000)\nraise SystemExit(3)")
    build = whole.Build("new", tmp_path / "tree", site)
    seconds, _, code = build.call(tmp_path / "log.txt", 0.3, "train")
    assert code == -9 and seconds < 30
    _, memory, code = build.call(tmp_path / "log.txt", 60.0, "graph")
    assert code == 3 and memory > 50


def test_an_old_tree_has_to_be_named(whole, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["whole_command.py"])
    with pytest.raises(SystemExit, match="old= must name a git worktree of d2e05c5"):
        whole.main()
