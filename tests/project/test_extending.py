"""The extension examples: each is a stranger's package of one file and one YAML, trained, judged and resumed."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from running import TINY, rows

EXTENDING = Path(__file__).parents[2] / "examples" / "extending"
FOLDERS = sorted(path.name for path in EXTENDING.iterdir() if path.is_dir())


def said(folder):
    """The command that an example's file shows, as words."""
    (file,) = (EXTENDING / folder).glob("*.py")
    shown = re.search(r"PYTHONPATH=(\S+) (python .*?)\n(?:\n|\"\"\")", file.read_text(encoding="utf-8"), re.DOTALL)
    return shown[1], shlex.split(shown[2].replace("\\\n", " "))


@pytest.fixture(scope="module", params=FOLDERS)
def trained(request, tmp_path_factory):
    """The name of an example, and a tiny run made with the command that it shows."""
    path, command = said(request.param)
    run = tmp_path_factory.mktemp(request.param) / "run"
    tiny = [f"{key}={value}" for key, value in TINY.items() if key not in without(request.param)]
    made = subprocess.run(
        [sys.executable, *command[1:], *tiny, f"hydra.run.dir={run}"],
        cwd=EXTENDING.parents[1],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
    )
    assert made.returncode == 0, made.stderr
    return request.param, run, path


def without(folder):
    """Settings of tiny trainings that an example has no use for."""
    return ("network.hidden",) if folder == "network" else ()


def test_every_example_is_one_file_and_one_yaml():
    assert FOLDERS == ["algorithm", "network", "node_feature", "reward_term", "termination", "whole_task"]
    for folder in FOLDERS:
        files = [f for f in (EXTENDING / folder).rglob("*") if f.is_file() and "__pycache__" not in f.parts]
        assert sorted(f.suffix for f in files) == [".py", ".yaml"], folder


def test_it_trains_and_is_judged_and_resumed(trained):
    folder, run, path = trained
    assert len(rows(run)) >= 2
    environment = {**os.environ, "PYTHONPATH": path, "GCTD3_MODULES": next((EXTENDING / folder).glob("*.py")).stem}
    for command in (
        ["gctd3.evaluate", f"run={run}", "episodes=2", "threads=1"],
        ["gctd3.train", f"resume={run}", "total_frames=320"],
    ):
        done = subprocess.run(
            [sys.executable, "-m", *command],
            cwd=EXTENDING.parents[1],
            env=environment,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
    assert int(rows(run)[-1]["frames"]) == 320
