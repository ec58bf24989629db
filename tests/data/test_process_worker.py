"""Workers in processes of their own: TorchRL's collectors, killed and stopped while they collect."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time

import pytest
from running import Recorded, command, rows, tiny, train
from workers import check_that_it_acts_with_the_weights_that_it_is_sent

from gctd3.data.process_worker import ProcessWorker

PROCESS = ["collector=process", "collector.chunk=2"]


def nobody_is_left():
    """Return whether all processes end soon; a killed one may take its time on a busy machine."""
    deadline = time.monotonic() + 60
    while multiprocessing.active_children() and time.monotonic() < deadline:
        time.sleep(0.1)
    return not multiprocessing.active_children()


@pytest.mark.nightly
def test_a_process_acts_with_the_weights_that_it_is_sent(robot):
    worker, weights = check_that_it_acts_with_the_weights_that_it_is_sent(ProcessWorker, robot)
    os.kill(worker.pid, signal.SIGKILL)
    with pytest.raises(RuntimeError, match="exit code -9"):
        worker.next(weights)
    worker.close()
    assert nobody_is_left()


class Struck(Recorded):
    """Train while one worker is killed and then the other one stopped."""

    def _learn(self, bar, seen):
        super()._learn(bar, seen)
        for frames, number, fault in ((96, 0, signal.SIGKILL), (160, 1, signal.SIGSTOP)):
            if self.counters.frames == frames:
                os.kill(self.collector._slots[number].worker.pid, fault)


@pytest.mark.nightly
def test_workers_that_die_or_hang_are_replaced_and_the_training_ends_well(tmp_path, capsys):
    # Its robots begin to walk at once, so that most of the time is the processes' start.
    run = tmp_path / "run"
    assert command("train", *tiny(run, *PROCESS, "collector.timeout=10"), trainer=Struck) == 0
    error = capsys.readouterr().err
    assert "Worker 0 failed (At least one process failed: worker 0 (exit code -9)" in error
    assert "Worker 1 has delivered nothing for 10 s: another takes its place, and its 2 robots start anew." in error
    trainer = Recorded.last
    assert trainer.collector.replaced == 2
    assert [int(row["frames"]) for row in rows(run)] == [80, 160, 240]
    # The number of updates follows from the frames after the warm-up: 2 for every step of the 4 robots.
    assert 2 * (240 - 80) // 4 <= trainer.algorithm.updates <= 2 * (240 - 80) // 4 + 4
    assert nobody_is_left()


@pytest.mark.nightly
def test_the_same_seed_gives_the_same_run_and_a_resumed_one_ends(tmp_path):
    first, second = (train(tmp_path / name, *PROCESS) for name in ("first", "second"))
    assert rows(first, drop=["wall_s"]) == rows(second, drop=["wall_s"])
    assert command("train", f"resume={first}", "total_frames=320", "collector.workers=1") == 0
    assert [int(row["frames"]) for row in rows(first)] == [80, 160, 240, 320]
    assert rows(first, drop=["wall_s"])[:3] == rows(second, drop=["wall_s"])


@pytest.mark.nightly
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGKILL, -9)])
def test_a_signal_to_all_processes_leaves_a_checkpoint_and_nobody_behind(tmp_path, number, code):
    run = tmp_path / "run"
    long = tiny(run, *PROCESS, "total_frames=400_000", "evaluation.every=400_000", "checkpoint_every=0.5")
    running = subprocess.Popen(
        [sys.executable, "-m", "gctd3.train", *long], stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    deadline = time.monotonic() + 300
    while not list(run.glob("checkpoints/step-*")):
        assert time.monotonic() < deadline and running.poll() is None, "no checkpoint"
        time.sleep(0.1)
    if number == signal.SIGKILL:
        running.kill()  # kill the learner only: its workers have to end by themselves
    else:
        os.killpg(running.pid, number)
    _, error = running.communicate(timeout=120)
    assert running.returncode == code, error
    assert "takes its place" not in error and "Traceback" not in error
    deadline = time.monotonic() + 60
    while subprocess.run(["pgrep", "-s", str(running.pid)], capture_output=True).stdout:
        assert time.monotonic() < deadline, "workers live on"
        time.sleep(0.5)
    reached = max(int(file.name.removeprefix("step-")) for file in run.glob("checkpoints/step-*"))
    assert command("train", f"resume={run}", f"total_frames={reached + 400}") == 0
