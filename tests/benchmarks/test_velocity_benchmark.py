"""The benchmark of commanded velocities: its table, and that it goes on where it stopped."""

import importlib.util
import json
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def bench(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    spec = importlib.util.spec_from_file_location("benchmark_of_velocities", BENCHMARKS / "velocity.py")
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)
    spec.loader.exec_module(module)
    return module


def rows():
    error = {"forward_m_s": 0.1, "side_m_s": 0.2, "turn_rad_s": 0.3}
    good = {"robot": "go2", "frames": 1000, "followed": 40}
    good["whole"] = {"commands": 46, "fall_rate": 0.25, "mean_abs_error": error}
    return [{**good, "seed": 0}, {"robot": "go2", "seed": 1, "failed": "exit code 1: no"}]


def test_failures_are_counted(bench):
    text = bench.table(rows()).splitlines()[-1]
    assert text == "| go2 | 2 | 1 | 1,000 | 40 of 46 | 25% | 0.10 | 0.20 | 0.30 |"
    assert bench.line(rows()[1]) == "go2, seed 1: failed, exit code 1: no"


def test_it_goes_on_where_it_stopped(bench, tmp_path, monkeypatch, capsys):
    """A cell with a file is left alone, a failed one is done again when asked for, others are done once."""
    asked = []

    def cell(robot, seed, folder, threads, settings, grid):
        asked.append((robot, seed, threads, settings))
        return {**rows()[0], "seed": seed} if seed else {"robot": robot, "seed": seed, "failed": "exit code 2: no"}

    monkeypatch.setattr(bench, "cell", cell)
    arguments = [f"out={tmp_path / 'out'}", f"runs={tmp_path / 'runs'}", "seeds=0,1", "settings=algo=td3 gamma=0.9"]
    for more, expected in (([], [0, 1]), ([], []), (["again=failed"], [0]), (["again=all"], [0, 1])):
        asked.clear()
        monkeypatch.setattr(sys, "argv", ["velocity.py", *arguments, *more])
        bench.main()
        assert [seed for _, seed, _, _ in asked] == expected
        assert all(settings == ["algo=td3", "gamma=0.9"] for _, _, _, settings in asked)
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == ["go2_seed0.json", "go2_seed1.json"]
    assert "1 of" not in capsys.readouterr().out
    monkeypatch.setattr(sys, "argv", ["velocity.py", "what=table", f"out={tmp_path / 'out'}"])
    bench.main()
    assert "| go2 | 2 | 1 |" in capsys.readouterr().out


@pytest.mark.nightly
def test_a_cell_is_trained_tested_and_continued(bench, tmp_path):
    from running import TINY

    settings = [f"{key}={value}" for key, value in TINY.items()]
    grid = ["grid.forward=2", "grid.side=1", "grid.turn=1", "grid.starts=1", "grid.seconds=1.5"]
    folder = tmp_path / "seed0"
    first = bench.cell("quadruped", 0, folder, 1, ["algo=td3", *settings], grid)
    assert first["whole"]["commands"] == 3 and first["frames"] == 240
    assert first["jumping"]["episodes"] == first["resampled"]["episodes"] == 200
    assert first["jumping"] != first["resampled"]
    wrong = bench.cell("quadrupet", 0, tmp_path / "other", 1, settings, grid)
    assert wrong["failed"].startswith("exit code 2: error: ") and "quadrupet" in wrong["failed"]
    assert json.loads((folder / "commands.json").read_text())["whole"] == first["whole"]
    # A finished training is not trained again.
    again = bench.cell("quadruped", 0, folder, 1, ["algo=td3", *settings], grid)
    assert again["whole"] == first["whole"] and again["minutes"] == first["minutes"] > 0
