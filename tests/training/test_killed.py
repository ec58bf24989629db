"""Trainings ended by a signal, a kill, a second training or a full disk continue from their checkpoint."""

import errno
import io
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from resuming import TIMED, assert_same_run
from running import command, process, rows, tiny, train, wait_for

from gctd3 import files
from gctd3.runs.load import load_policy
from gctd3.training.checkpoint import Checkpoints
from gctd3.training.run_lock import only_one


def start(run, *overrides):
    arguments = [*tiny(run, *overrides)] if not run.exists() else [f"resume={run}"]
    module = [sys.executable, "-m", "gctd3.train", *arguments]
    # As where a user runs it, output to a pipe is not written at once.
    environment = {**os.environ, "PYTHONUNBUFFERED": ""}
    return subprocess.Popen(module, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)


LONG = ["total_frames=4000", "evaluation.every=400", "checkpoint_every=0.2"]
# Its first evaluation comes soon.
SOON = [*LONG, "evaluation.every=80"]


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("number", "code"),
    [
        (signal.SIGINT, 130),
        (signal.SIGTERM, 143),
        (signal.SIGHUP, 129),
    ],
)
def test_a_signal_finishes_the_step_and_says_how_to_go_on(tmp_path, number, code):
    run = tmp_path / "run"
    running = start(run, *SOON)
    wait_for(lambda: list(run.glob("checkpoints/best-*")))
    running.send_signal(number)
    out, error = running.communicate(timeout=60)
    assert running.returncode == code, error
    assert "Traceback" not in error
    assert f"Continue it:  python -m gctd3.train resume={run}" in out
    assert load_policy(run) is not None
    before = rows(run)
    # The whole training would take long.
    reached = Checkpoints(run).newest()[0]["counters"]["frames"]
    assert 80 <= reached < 4000
    assert command("train", f"resume={run}", f"total_frames={reached + 80}") == 0
    assert rows(run)[: len(before)] == before
    assert reached < int(rows(run)[-1]["frames"]) <= reached + 80


@pytest.mark.nightly
def test_a_second_signal_leaves_at_once(tmp_path):
    run = tmp_path / "run"
    # Steps of minutes, so that the first signal alone would not end it soon.
    running = start(run, *LONG, "gradient_steps=100_000", "exploration.learning_starts=4")
    wait_for(lambda: (run / ".hydra" / "config.yaml").exists())
    time.sleep(2.0)
    running.send_signal(signal.SIGINT)
    time.sleep(0.5)
    assert running.poll() is None
    running.send_signal(signal.SIGINT)
    out, error = running.communicate(timeout=10)
    assert running.returncode == -signal.SIGINT
    assert "once more leaves at once" in out
    assert "Traceback" not in error


@pytest.mark.nightly
@pytest.mark.parametrize("apart", [0.0, 0.001, 0.01])
def test_two_signals_close_to_one_another_print_no_traceback(tmp_path, apart):
    run = tmp_path / "run"
    running = start(run, *LONG)
    wait_for(lambda: (run / ".hydra" / "config.yaml").exists())
    time.sleep(1.0)
    running.send_signal(signal.SIGTERM)
    time.sleep(apart)
    running.send_signal(signal.SIGINT)
    _, error = running.communicate(timeout=60)
    assert running.returncode in (-signal.SIGTERM, -signal.SIGINT, 143, 130)
    assert "Traceback" not in error and "OSError" not in error and "Exception ignored" not in error


@pytest.mark.nightly
@pytest.mark.parametrize("gone", ["stdout", "stderr", "both"])
def test_a_training_whose_output_nobody_reads_any_more_ends_as_any_other(finished, tmp_path, gone):
    run = tmp_path / "run"
    running = start(run)
    while "Run directory" not in running.stdout.readline():  # where the training begins
        pass
    for name in ("stdout", "stderr"):
        if gone in (name, "both"):
            getattr(running, name).close()
            setattr(running, name, None)
    _, error = running.communicate(timeout=120)
    assert running.returncode == 0 and "Traceback" not in (error or "")
    assert_same_run(finished["gctd3"], run)


@pytest.mark.nightly
@pytest.mark.parametrize("settings", [{"PYTHONIOENCODING": "ascii"}, {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0"}])
def test_a_terminal_that_shows_ascii_only(tmp_path, settings):
    call = [sys.executable, "-m", "gctd3.train", *tiny(tmp_path / "run")]
    environment = {**os.environ, "PYTHONUTF8": "0", **settings}
    done = subprocess.run(call, capture_output=True, env=environment)
    assert done.returncode == 0 and b"Traceback" not in done.stderr
    assert b"+-" in done.stdout and done.stdout.isascii()


@pytest.mark.nightly
def test_a_result_is_shown_on_a_terminal_that_shows_ascii_only(tmp_path, monkeypatch):
    content = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(content, encoding="ascii"))
    train(tmp_path / "run")
    sys.stdout.flush()
    assert re.search(rb"return -?[\d.]+ \+- [\d.]+", content.getvalue())


@pytest.mark.nightly
def test_a_signal_while_the_training_is_being_built(tmp_path):
    run = tmp_path / "run"
    running = start(run, *LONG)
    wait_for(lambda: (run / ".lock").exists())
    running.send_signal(signal.SIGINT)
    out, error = running.communicate()
    assert running.returncode == 130
    assert "Traceback" not in error
    assert f"Continue it:  python -m gctd3.train resume={run}" in out


@pytest.mark.nightly
def test_the_directory_of_a_training_is_taken(finished, tmp_path, capsys):
    run = finished.copy("gctd3", tmp_path / "run")
    with only_one(run):
        for arguments in (tiny(run), [f"resume={run}", "total_frames=400"]):
            capsys.readouterr()
            assert command("train", *arguments) == 2
            assert "Another training writes to" in capsys.readouterr().err
    assert rows(run) == rows(finished["gctd3"])


@pytest.mark.nightly
def test_a_second_training_in_the_directory_is_refused(tmp_path):
    run = tmp_path / "run"
    running = start(run, *LONG, "total_frames=400_000", "evaluation.every=400_000")
    try:
        wait_for(lambda: list(run.glob("checkpoints/step-*")))
        for arguments in (tiny(run), [f"resume={run}"]):
            second = process("train", *arguments)
            assert second.returncode == 2
            assert "Another training writes to" in second.stderr
    finally:
        running.kill()
        running.communicate()


def killed_at(run, seconds):
    """Kill the training so many seconds after its first file appears, with a signal that cannot be caught."""
    running = start(run, *LONG)
    wait_for(lambda: (run / "progress.csv").exists() or list(run.glob("checkpoints/*")) or running.poll() is not None)
    time.sleep(seconds)
    running.kill()
    running.communicate()
    return running.returncode


@pytest.mark.nightly
def test_killed_at_any_moment_resumes_and_ends_as_if_left_alone(tmp_path):
    whole = train(tmp_path / "whole", *LONG)
    kill_and_compare(tmp_path / "run", whole, [0.3, 1.1])


@pytest.mark.nightly
def test_thirty_kills(tmp_path):
    whole = train(tmp_path / "whole", *LONG)
    generator = torch.Generator().manual_seed(0)
    moments = torch.rand(30, generator=generator) * 2.5
    for i in range(10):
        kill_and_compare(tmp_path / f"run{i}", whole, moments[3 * i : 3 * i + 3].tolist())


def kill_and_compare(run, whole, moments):
    for seconds in moments:
        if killed_at(run, seconds) == 0:
            break
        if (run / "progress.csv").exists():
            assert rows(run, drop=TIMED) == rows(whole, drop=TIMED)[: len(rows(run))]
    done = process("train", f"resume={run}")
    assert done.returncode in (0, 2), done.stderr
    if done.returncode == 2:
        assert "is finished" in done.stderr
    assert_same_run(whole, run)


# Checkpoints as often as can be, whatever the disk's speed, so that every run flushes the same files in the same order.
OFTEN = "checkpoint_every=1e-9"
DYING = """
import math, os, sys
from gctd3 import files, train
from gctd3.training import trainer
trainer.MOST_TIME = math.inf
left = {left}
flush = files._flush
def counting(path):
    global left
    left -= 1
    if not left:
        print("Died before", path, flush=True)
        os._exit(9)
    flush(path)
files._flush = counting
sys.argv = ["train", *{arguments!r}]
train.main()
"""


def killed_before(run, flushes):
    """Kill a training before it flushes a file; return the kind of the file."""
    code = DYING.format(left=flushes, arguments=tiny(run, OFTEN))
    killed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert killed.returncode == 9, killed.stderr
    name = re.search(r"Died before .*/(.*)", killed.stdout)[1]
    return re.sub(r"[\d-]+", "-", re.sub(r"\.[0-9a-f]{16}\.tmp$", ".tmp", name))


def assert_goes_on(whole, run, *overrides):
    assert command("train", f"resume={run}", *overrides) == 0
    assert_same_run(whole, run)
    assert not list(run.rglob("*.tmp"))


@pytest.mark.nightly
def test_what_a_kill_inside_a_checkpoint_would_leave_goes_on(finished, tmp_path, monkeypatch):
    """A kill leaves of a run what is on the disk at that moment, which a copy keeps."""
    whole, run = finished["gctd3"], tmp_path / "run"
    monkeypatch.setattr("gctd3.training.trainer.MOST_TIME", math.inf)
    flushed, flush = [], files._flush

    def copying(path):
        flushed.append(path)
        # Its rows of the replay are written by then, and no manifest names them.
        if Path(path).name == "state.safetensors" and sum(Path(p).name == Path(path).name for p in flushed) == 2:
            shutil.copytree(run, tmp_path / "left")
        flush(path)

    with monkeypatch.context() as patch:
        patch.setattr(files, "_flush", copying)
        train(run, OFTEN, "total_frames=120", without=["total_frames"])
    assert list((tmp_path / "left").rglob("*.tmp"))
    assert_goes_on(whole, tmp_path / "left", "total_frames=240")


@pytest.mark.nightly
def test_a_kill_before_any_file_of_a_checkpoint_leaves_the_one_before(finished, tmp_path, monkeypatch):
    whole, struck = finished["gctd3"], set()
    monkeypatch.setattr("gctd3.training.trainer.MOST_TIME", math.inf)
    for count in range(6):
        struck.add(killed_before(tmp_path / f"run{count}", 20 + count))
        assert_goes_on(whole, tmp_path / f"run{count}")
    assert struck >= {".rows-.safetensors.tmp", "state.safetensors", "manifest.json", ".step-.tmp", "checkpoints"}


@pytest.mark.nightly
def test_a_file_that_finds_no_room_leaves_the_last_checkpoint(finished, tmp_path, monkeypatch, capsys):
    """A disk that is full from the third file of the second checkpoint on leaves the first checkpoint whole."""
    whole, run = finished["gctd3"], tmp_path / "run"
    monkeypatch.setattr("gctd3.training.trainer.MOST_TIME", math.inf)
    flushed, flush = [], files._flush

    def full(path):
        flushed.append(path)
        if len(flushed) > 14:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        flush(path)

    with monkeypatch.context() as patch:
        patch.setattr(files, "_flush", full)
        assert command("train", *tiny(run, OFTEN)) == 2
    error = capsys.readouterr().err
    assert "Traceback" not in error and "No space left on device" in error and f"resume={run}" in error
    assert Checkpoints(run).newest() is not None
    assert_goes_on(whole, run)


@pytest.mark.nightly
def test_a_full_disk_says_so_and_leaves_the_last_checkpoint(tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=3m", "none", str(disk)], capture_output=True).returncode:
        pytest.skip("tmpfs cannot be mounted here")
    try:
        run = disk / "run"
        many = ["env.num_envs=64", "total_frames=100_000", "evaluation.every=100_000", "replay.buffer_size=100_000"]
        done = process("train", *tiny(run, *many, "gradient_steps=1", "checkpoint_every=0.1"))
        assert done.returncode == 2
        assert "Traceback" not in done.stderr
        assert "No space left on device" in done.stderr
        assert f"resume={run}" in done.stderr
        assert Checkpoints(run).newest() is not None
        assert not list(run.rglob("*.tmp"))
        elsewhere = tmp_path / "elsewhere"
        shutil.copytree(run, elsewhere)
    finally:
        subprocess.run(["umount", str(disk)], check=True)
    state, _ = Checkpoints(elsewhere).newest()
    more = int(state["counters"]["frames"]) + 640
    assert command("train", f"resume={elsewhere}", f"total_frames={more}") == 0
