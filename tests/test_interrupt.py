"""Stopping a training by Ctrl-C, and not writing over one."""

import signal
import subprocess
import sys
import time

import pytest

TINY = [
    "env.num_envs=4",
    "env.threads=1",
    "threads=1",
    "logger=none",
    "exploration.warmup_frames=40",
    "updates=1",
    "evaluation.every=40",
    "evaluation.episodes=2",
    "replay.batch_size=16",
    "network.hidden=[16,16]",
    "stop_when.evaluations=null",
]


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory):
    """A training of a million frames that got a Ctrl-C after its first evaluation: directory, exit code, output."""
    run = tmp_path_factory.mktemp("interrupted") / "run"
    command = [sys.executable, "-m", "gctd3.train", *TINY, "total_frames=1_000_000", f"hydra.run.dir={run}"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=run.parent)
    deadline = time.monotonic() + 120
    # The first checkpoint is whole once its directory has its name.
    while not list(run.glob("checkpoints/checkpoint-*")) and time.monotonic() < deadline:
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    out, error = process.communicate(timeout=60)
    return run, process.returncode, out, error


def test_ctrl_c_keeps_the_best_policy_and_says_so(interrupted):
    run, code, out, error = interrupted
    assert code == 130, error
    assert "Traceback" not in error
    assert "Interrupted; the best policy so far is kept." in out
    assert f"python -m gctd3.evaluate run={run}" in out
    judged = [sys.executable, "-m", "gctd3.evaluate", f"run={run}", "episodes=2", "threads=1"]
    subprocess.run(judged, check=True, capture_output=True, cwd=run.parent)
    assert (run / "evaluation.json").is_file()


def test_a_directory_that_holds_a_run_is_left_alone(interrupted):
    run, *_ = interrupted
    before = (run / "progress.csv").read_text()
    command = [sys.executable, "-m", "gctd3.train", *TINY, f"hydra.run.dir={run}"]
    again = subprocess.run(command, capture_output=True, text=True, check=False, cwd=run.parent)
    assert again.returncode == 2
    assert again.stderr == f"error: {run} holds a run already: choose another hydra.run.dir.\n"
    assert (run / "progress.csv").read_text() == before
