"""The policy in the package is complete, small and walks, and commands without a run use it."""

import importlib
import json
import re
import shutil
import sys
from pathlib import Path

import pytest
import torch
from running import command
from tensordict import TensorDict

import gctd3
from gctd3.files import checksum
from gctd3.runs.evaluate import table
from gctd3.training.checkpoint import Checkpoints, checked
from gctd3.training.saved_configuration import find_run, load_settings

ROOT = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def shipping(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    module = importlib.import_module("ship_policy")
    monkeypatch.setattr(module, "EPISODES", 2)
    return module


def contents(folder):
    return {str(path.relative_to(folder)): checksum(path) for path in folder.rglob("*") if path.is_file()}


def test_it_is_a_run_without_its_training():
    folder = find_run(None)
    best = Checkpoints(folder).best()
    files = {str(Path(name)) for name in contents(folder)}
    inside = str(best.relative_to(folder))
    assert files == {
        ".hydra/config.yaml",
        ".hydra/overrides.yaml",
        f"{inside}/manifest.json",
        f"{inside}/policy.safetensors",
        "robot/manifest.json",
        "robot/numbers.npz",
        "robot/robot.xml",
        "evaluation.json",
    }
    assert sum(path.stat().st_size for path in folder.rglob("*")) < 1_000_000
    assert re.fullmatch(r"[0-9a-f]{7,40}", checked(best)["commit"])
    settings = load_settings(folder)
    assert (settings.robot.name, type(settings.algo).__name__, len(settings.network.graph_layers)) == (
        "biped",
        "TD3Settings",
        3,
    )
    assert not re.search(r"(?<![\w.])/(?!/)\w", (folder / ".hydra" / "overrides.yaml").read_text())


def test_its_evaluation_is_a_walks(shipping):
    evaluation = json.loads((find_run(None) / "evaluation.json").read_text())
    assert (evaluation["episodes"], evaluation["success_rate"]) == (50, 1.0)
    assert shipping.lacking(evaluation) == []
    hopping = {**evaluation, "gait": {**evaluation["gait"], "hip_correlation": 0.9}}
    assert shipping.lacking(hopping) == ["hip_correlation"]


def test_the_package_data_covers_every_file():
    tomllib = pytest.importorskip("tomllib")
    data = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]
    for package in ("conf", "models"):
        folder = ROOT / package
        packed = {path for pattern in data[f"gctd3.{package}"] for path in folder.glob(pattern)}
        there = {path for path in folder.rglob("*") if path.is_file() and path.suffix not in (".py", ".pyc")}
        assert len(there) > 10 and there == {path for path in packed if path.is_file()}


@pytest.mark.nightly
def test_without_a_run_commands_use_it_and_leave_it_alone(tmp_path, capsys):
    before = contents(find_run(None))
    assert command("evaluate", "episodes=2", "threads=1") == 0
    said = capsys.readouterr().out
    assert re.search(r"success rate +1\.00", said) and "Written" not in said and "Nothing is written" in said
    assert contents(find_run(None)) == before
    assert not list(tmp_path.iterdir())
    assert command("evaluate", "episodes=1", "threads=1", f"out={tmp_path / 'new' / 'folder'}") == 0
    assert sorted(path.name for path in (tmp_path / "new" / "folder").iterdir()) == ["evaluation.json", "trace.csv"]
    assert contents(find_run(None)) == before


def test_load_policy_needs_no_run():
    nodes = torch.randn(20, 8, 10)
    mine, same = (policy(TensorDict({"nodes": nodes}, [20]))["action"] for policy in both())
    assert torch.equal(mine, same)


def both():
    return gctd3.load_policy(), gctd3.load_policy(find_run(None))


def ship(module, monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["ship_policy.py", *arguments])
    module.main()


@pytest.mark.nightly
def test_shipping_evaluates_and_copies(shipping, tmp_path, monkeypatch):
    run, to = tmp_path / "run", tmp_path / "biped" / "policy"
    shutil.copytree(find_run(None), run)
    (run / "progress.csv").write_text("of the training\n")
    ship(shipping, monkeypatch, f"run={run}", f"to={to}", "commit=abcdef0")
    new, old = contents(to), contents(find_run(None))
    assert set(new) == set(old)
    assert {name for name in new if new[name] != old[name]} == {
        name for name in new if name.endswith(".json") and not name.startswith("robot/")
    }
    assert checked(Checkpoints(to).best())["commit"] == "abcdef0"
    assert json.loads((to / "evaluation.json").read_text())["episodes"] == 2


def test_shipping_refuses_what_does_not_walk(shipping, finished, tmp_path, monkeypatch):
    run, to = finished.copy("gctd3", tmp_path / "run"), tmp_path / "biped" / "policy"
    shutil.copytree(find_run(None), to)
    before = contents(to)
    with pytest.raises(SystemExit, match=r"does not walk: .*success_rate"):
        ship(shipping, monkeypatch, f"run={run}", f"to={to}", "commit=abcdef0")
    with pytest.raises(SystemExit, match="commit first, or say commit="):
        ship(shipping, monkeypatch, f"run={run}", f"to={to}", "commit=abcdef0-dirty")
    with pytest.raises(SystemExit, match=r"is of the robot biped, .* is for quadruped"):
        ship(shipping, monkeypatch, f"run={run}", f"to={tmp_path / 'quadruped' / 'policy'}", "commit=abcdef0")
    with pytest.raises(SystemExit, match="run=DIR is required"):
        ship(shipping, monkeypatch, "commit=abcdef0")
    assert contents(to) == before
    assert sorted(path.name for path in to.parent.iterdir()) == ["policy"]


@pytest.mark.parametrize(("robot", "compared"), [("biped", True), ("go2", False)])
def test_the_papers_numbers_stand_beside_its_own_robot_only(robot, compared):
    numbers = dict.fromkeys(("return_mean", "return_std", "velocity_mean", "distance_mean", "success_rate"), 0.5)
    report = {"robot": robot, "reward": {}, "episodes": 2, "body_position_mean": 0.0, "gait": {}, **numbers}
    assert ("paper, GCTD3" in table(report)) == compared
