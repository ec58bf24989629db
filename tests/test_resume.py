"""Going on as if nothing had happened: stopped, killed or extended runs against ones that were left alone."""

import json
import math
import re
import shutil
import signal
import subprocess
import sys
import time

import pytest
import torch
from running import TINY, Recorded, command, process, rows, tiny, train

from gctd3.checkpoint import Checkpoints, load_policy
from gctd3.files import load_tree

TIMED = ("wall_s",)


class StopAfter:
    """Asks to stop once a training has so many frames."""

    def __init__(self, trainer, frames):
        self.trainer, self.frames = trainer, frames

    def __bool__(self):
        return self.trainer.counters.frames >= self.frames


def stopped(directory, frames, *overrides, without=()):
    """A run that was stopped after ``frames``."""

    class Stopped(Recorded):
        def run(self, stop=None):
            return super().run(StopAfter(self, frames))

    assert command("train", *tiny(directory, *overrides, without=without), trainer=Stopped) == 0
    return directory


def final_state(run):
    """The whole state in the newest checkpoint, replay rows included."""
    state, parts = Checkpoints(run).newest()
    parts = list(parts)
    # Older parts may begin before the ring does.
    rows = TINY["replay.capacity"] // TINY["env.num_envs"]
    state["rows"] = {key: torch.cat([part[key] for _, part in parts])[-rows:] for key in parts[0][1]} if parts else {}
    return state


def assert_equal(first, second, path="state"):
    if isinstance(first, dict):
        assert first.keys() == second.keys(), path
        for key in first:
            if key not in TIMED:
                assert_equal(first[key], second[key], f"{path}.{key}")
    elif isinstance(first, list):
        assert len(first) == len(second), path
        for i, (one, other) in enumerate(zip(first, second, strict=True)):
            assert_equal(one, other, f"{path}[{i}]")
    elif hasattr(first, "shape"):
        assert first.dtype == second.dtype, path
        assert (first == second).all(), path
    else:
        assert first == second or (first != first and second != second), path


def assert_same_run(first, second):
    assert rows(first, drop=TIMED) == rows(second, drop=TIMED)
    assert_equal(final_state(first), final_state(second))
    best = [load_tree(Checkpoints(run).best() / "policy.safetensors") for run in (first, second)]
    assert_equal(*best)


CASES = [(algo, backend, "frames") for algo in ("gctd3", "td3", "ddpg", "sac") for backend in ("batched", "dm_control")]


@pytest.mark.parametrize(("algo", "backend", "storage"), [*CASES, ("td3", "batched", "stacked")])
def test_stopped_and_resumed_equals_left_alone(tmp_path, algo, backend, storage):
    settings = [f"algo={algo}", f"env.backend={backend}", f"replay.storage={storage}"]
    whole = train(tmp_path / "whole", *settings)
    # In the middle of episodes, between two evaluations.
    part = stopped(tmp_path / "part", 128, *settings)
    assert [row["frames"] for row in rows(part)] == ["80"]
    assert command("train", f"resume={part}") == 0
    assert_same_run(whole, part)


def test_stopped_in_the_warm_up_and_twice_more(tmp_path):
    whole = train(tmp_path / "whole")
    part = stopped(tmp_path / "part", 40)

    class Again(Recorded):
        def run(self, stop=None):
            return super().run(StopAfter(self, self.counters.frames + 60))

    assert command("train", f"resume={part}", trainer=Again) == 0
    assert command("train", f"resume={part}") == 0
    assert_same_run(whole, part)


@pytest.mark.parametrize("storage", ["frames", "stacked"])
def test_stopped_after_it_had_begun_again(tmp_path, storage):
    never = ["stop_when.at_least.velocity_mean=100", "stop_when.restart_after=80", "exploration.warmup_frames=40"]
    settings = [*never, f"replay.storage={storage}", "total_frames=320"]
    whole = train(tmp_path / "whole", *settings)
    assert [row["restarts"] for row in rows(whole)] == ["0", "1", "2", "3"]
    part = stopped(tmp_path / "part", 200, *settings)
    assert command("train", f"resume={part}") == 0
    assert_same_run(whole, part)


def test_more_frames_extend_a_finished_run(tmp_path):
    long = train(tmp_path / "long", "total_frames=400")
    run = train(tmp_path / "run")
    assert command("train", f"resume={run}") == 2
    assert command("train", f"resume={run}", "total_frames=400") == 0
    assert rows(run, drop=TIMED) == rows(long, drop=TIMED)
    # It is now a run of 400 frames.
    assert command("train", f"resume={run}") == 2


def test_other_settings_are_refused_by_name_and_harmless_ones_taken(tmp_path, capsys):
    run = stopped(tmp_path / "run", 80)
    capsys.readouterr()
    assert command("train", f"resume={run}", "algo.gamma=0.9", "updates=3", "logger=csv") == 2
    error = capsys.readouterr().err
    assert "algo.gamma: 0.99 -> 0.9" in error
    assert "updates: 2 -> 3" in error
    assert "logger:" not in error
    assert command("train", f"resume={run}", "algo=sac") == 2
    assert "algo._target_: 'gctd3.algorithms.td3.TD3Settings' -> 'gctd3.algorithms.sac" in capsys.readouterr().err
    assert command("train", f"resume={run}", "logger=csv", "total_frames=160") == 0
    assert [row["frames"] for row in rows(run)] == ["80", "160"]
    assert (run / "csv").is_dir()


def test_the_csv_logger_goes_back_to_the_checkpoint(tmp_path):
    whole = train(tmp_path / "whole", "logger=csv")
    part = stopped(tmp_path / "part", 176, "logger=csv")
    shutil.copytree(part / "checkpoints", tmp_path / "kept")
    assert command("train", f"resume={part}") == 0
    # Back to the moment of the stop, as if what came after it had never been saved.
    shutil.rmtree(part / "checkpoints")
    shutil.copytree(tmp_path / "kept", part / "checkpoints")
    assert command("train", f"resume={part}") == 0
    files = sorted(path.relative_to(whole / "csv") for path in (whole / "csv").rglob("*.csv"))
    assert len(files) > 5
    for file in files:
        if "wall" not in file.name:
            assert (part / "csv" / file).read_text() == (whole / "csv" / file).read_text(), file


def test_tensorboard_goes_back_to_the_checkpoint(tmp_path):
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    part = stopped(tmp_path / "part", 96, "logger=tensorboard")
    shutil.copytree(part / "checkpoints", tmp_path / "kept")
    for _ in range(2):
        shutil.rmtree(part / "checkpoints")
        shutil.copytree(tmp_path / "kept", part / "checkpoints")
        assert command("train", f"resume={part}") == 0
    (folder,) = {file.parent for file in part.rglob("events*")}
    events = accumulator.EventAccumulator(str(folder)).Reload()
    assert [event.step for event in events.Scalars("evaluation/return_mean")] == [80, 160, 240]


@pytest.mark.parametrize("missing", ["", "empty"])
def test_no_run_to_resume(tmp_path, capsys, missing):
    if missing:
        (tmp_path / "run").mkdir()
    assert command("train", f"resume={tmp_path / 'run'}") == 2
    assert "there is no run to continue" in capsys.readouterr().err
    assert [path.name for path in tmp_path.rglob("*")] == (["run"] if missing else [])


def test_a_damaged_checkpoint_is_passed_over(tmp_path, capsys):
    whole = train(tmp_path / "whole", "checkpoint_every=0.001")
    part = stopped(tmp_path / "part", 160, "checkpoint_every=0.001")
    newest, before = sorted((part / "checkpoints").glob("step-*"), reverse=True)[:2]
    state = newest / "state.safetensors"
    damaged = bytearray(state.read_bytes())
    damaged[len(damaged) // 2] ^= 1
    state.write_bytes(damaged)
    capsys.readouterr()
    assert command("train", f"resume={part}") == 0
    error = capsys.readouterr().err
    assert "Passed over a checkpoint" in error
    assert str(state) in error
    assert_same_run(whole, part)
    # A part of the replay that only the newest names is damaged: it must not live on in those after it.
    again = stopped(tmp_path / "again", 160, "checkpoint_every=0.001")
    newest_part = max((again / "checkpoints" / "replay").iterdir())
    newest_part.write_bytes(newest_part.read_bytes()[:-1])
    assert command("train", f"resume={again}") == 0
    assert str(newest_part) in capsys.readouterr().err
    assert_same_run(whole, again)
    for path in (part / "checkpoints").glob("step-*"):
        (path / "manifest.json").write_text("{")
    assert command("train", f"resume={part}") == 2
    assert "checkpoints in" in capsys.readouterr().err
    assert before.name < newest.name


def test_a_sweep_goes_on_where_it_stopped(tmp_path):
    whole = {seed: train(tmp_path / f"whole{seed}", f"seed={seed}") for seed in (0, 1)}
    settings = [f"{key}={value}" for key, value in TINY.items()]
    sweep = ["-m", *settings, "seed=0,1", f"hydra.sweep.dir={tmp_path / 'sweep'}", "hydra.sweep.subdir=${seed}"]

    class Stopped(Recorded):
        def run(self, stop=None):
            return super().run(StopAfter(self, 128) if self.settings.seed else None)

    assert command("train", *sweep, trainer=Stopped) == 0
    finished = (tmp_path / "sweep" / "0" / "progress.csv").read_text()
    assert command("train", *sweep) == 0
    assert (tmp_path / "sweep" / "0" / "progress.csv").read_text() == finished
    for seed, run in whole.items():
        assert_same_run(run, tmp_path / "sweep" / str(seed))


def start(run, *overrides):
    arguments = [*tiny(run, *overrides)] if not run.exists() else [f"resume={run}"]
    module = [sys.executable, "-m", "gctd3.train", *arguments]
    return subprocess.Popen(module, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for(condition, seconds=120):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "nothing happened"
        time.sleep(0.02)


LONG = ["total_frames=4000", "evaluation.every=400", "checkpoint_every=0.2"]


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_finishes_the_step_and_says_how_to_go_on(tmp_path, number, code):
    run = tmp_path / "run"
    running = start(run, *LONG)
    wait_for(lambda: list(run.glob("checkpoints/best-*")))
    running.send_signal(number)
    out, error = running.communicate(timeout=60)
    assert running.returncode == code, error
    assert "Traceback" not in error
    assert f"Continue it:  python -m gctd3.train resume={run}" in out
    assert load_policy(run) is not None
    before = rows(run)
    done = process("train", f"resume={run}")
    assert done.returncode == 0, done.stderr
    assert rows(run)[: len(before)] == before
    assert int(rows(run)[-1]["frames"]) == 4000


def test_a_second_signal_leaves_at_once(tmp_path):
    run = tmp_path / "run"
    # Steps of minutes, so that the first signal alone would not end it soon.
    running = start(run, *LONG, "updates=100_000")
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


def test_a_signal_while_the_training_is_being_built(tmp_path):
    run = tmp_path / "run"
    running = start(run, *LONG)
    wait_for(lambda: (run / ".lock").exists())
    running.send_signal(signal.SIGINT)
    out, error = running.communicate()
    assert running.returncode == 130
    assert "Traceback" not in error
    assert f"Continue it:  python -m gctd3.train resume={run}" in out


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


def test_killed_at_any_moment_resumes_and_ends_as_if_left_alone(tmp_path):
    whole = train(tmp_path / "whole", *LONG)
    kill_and_compare(tmp_path / "run", whole, [0.3, 1.1])


@pytest.mark.slow
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
from gctd3 import files, train, trainer
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


def test_a_kill_inside_a_checkpoint_leaves_the_one_before(tmp_path, monkeypatch):
    """Whatever file a checkpoint was about to write when it was killed."""
    monkeypatch.setattr("gctd3.trainer.MOST_TIME", math.inf)
    whole = train(tmp_path / "whole", OFTEN)
    struck = set()
    for count in range(6):
        run = tmp_path / f"run{count}"
        code = DYING.format(left=20 + count, arguments=tiny(run, OFTEN))
        killed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        assert killed.returncode == 9, killed.stderr
        struck.add(re.sub(r"[\d-]+", "-", re.search(r"Died before .*/(.*)", killed.stdout)[1]))
        assert command("train", f"resume={run}") == 0, count
        assert_same_run(whole, run)
        assert not list(run.rglob("*.tmp"))
    assert struck >= {".rows-.safetensors.tmp", "state.safetensors", "manifest.json", ".step-.tmp", "checkpoints"}


def test_a_full_disk_says_so_and_leaves_the_last_checkpoint(tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=3m", "none", str(disk)], capture_output=True).returncode:
        pytest.skip("tmpfs cannot be mounted here")
    try:
        run = disk / "run"
        many = ["env.num_envs=64", "total_frames=100_000", "evaluation.every=100_000", "replay.capacity=100_000"]
        done = process("train", *tiny(run, *many, "updates=1", "checkpoint_every=0.1"))
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


def test_manifests_say_what_they_are_of(tmp_path):
    run = train(tmp_path / "run")
    for path in (Checkpoints(run).best(), *(run / "checkpoints").glob("step-*")):
        content = json.loads((path / "manifest.json").read_text())["content"]
        assert content["format"] == 2
        assert content["versions"]["torch"] == torch.__version__.split("+")[0] or content["versions"]["torch"]
        assert content["config"]["env"]["num_envs"] == TINY["env.num_envs"]
        assert ["body", "hip_right"] in content["graph"]["edges"]
