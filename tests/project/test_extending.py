"""Each extension example is a separate package of one file and one YAML; it trains, is evaluated and resumes."""

import re
import shlex
from pathlib import Path

import pytest
from running import TINY, command, rows

EXTENDING = Path(__file__).parents[2] / "examples" / "extending"
FOLDERS = sorted(path.name for path in EXTENDING.iterdir() if path.is_dir())
# A task brings terms of every kind.
QUICK = ("network",)


def said(folder):
    """Return the words of the command that an example's file shows."""
    (file,) = (EXTENDING / folder).glob("*.py")
    shown = re.search(r"PYTHONPATH=(\S+) (python .*?)\n(?:\n|\"\"\")", file.read_text(encoding="utf-8"), re.DOTALL)
    return shown[1], shlex.split(shown[2].replace("\\\n", " "))


@pytest.fixture(params=[pytest.param(f, marks=[pytest.mark.nightly] * (f not in QUICK)) for f in FOLDERS])
def trained(request, tmp_path, monkeypatch):
    """Train a tiny run with the command that an example shows."""
    path, arguments = said(request.param)
    monkeypatch.chdir(EXTENDING.parents[1])
    monkeypatch.syspath_prepend(path)
    few = {**TINY, "total_frames": 120, "exploration.learning_starts": 40, "evaluation.every": 60}
    tiny = [f"{key}={value}" for key, value in few.items() if key not in without(request.param)]
    assert command("train", *arguments[3:], *tiny, f"hydra.run.dir={tmp_path / 'run'}") == 0
    return tmp_path / "run"


def without(folder):
    """Return the settings of tiny trainings that an example does not use."""
    return ("network.hidden",) if folder == "network" else ()


def test_every_example_is_one_file_and_one_yaml():
    assert FOLDERS == ["algorithm", "network", "node_feature", "reward_term", "termination", "whole_task"]
    for folder in FOLDERS:
        files = [f for f in (EXTENDING / folder).rglob("*") if f.is_file() and "__pycache__" not in f.parts]
        assert sorted(f.suffix for f in files) == [".py", ".yaml"], folder


# Plain layers cannot run as a stack, and a line says that this is slower.
@pytest.mark.filterwarnings("ignore::gctd3.errors.PerformanceWarning")
def test_it_trains_and_is_evaluated_and_resumed(trained):
    run = trained
    assert len(rows(run)) >= 2
    # What is imported already is trusted.
    assert command("evaluate", f"run={run}", "episodes=1", "threads=1") == 0
    assert command("train", f"resume={run}", "total_frames=160") == 0
    assert int(rows(run)[-1]["frames"]) == 160
