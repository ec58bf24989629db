"""Sweeps with Hydra's launchers: their settings are checked at once; whole sweeps are slow."""

import importlib.util
import json
import signal
import subprocess
import sys
import time

import pytest
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf
from running import TINY, command, process, rows

SETTINGS = [f"{key}={value}" for key, value in TINY.items()]


def installed(name):
    plugin = importlib.util.find_spec("hydra_plugins")
    return plugin is not None and importlib.util.find_spec(f"hydra_plugins.hydra_{name}_launcher") is not None


def needs(name):
    return pytest.mark.skipif(not installed(name), reason=f"hydra-{name}-launcher is not installed")


@pytest.mark.parametrize("name", ["ray", "submitit"])
def test_without_its_package_a_launcher_says_what_to_install(tmp_path, capsys, monkeypatch, name):
    if installed(name):
        pytest.skip("it is installed")
    monkeypatch.chdir(tmp_path)
    assert command("train", "-m", f"hydra/launcher={name}", *SETTINGS, "seed=0,1") == 2
    assert f"hydra/launcher={name} needs its package: pip install 'gctd3[{name}]'" in capsys.readouterr().err


def test_runs_get_their_cpus_gpus_and_time():
    """Each launcher accepts CPUs, GPUs and a time limit, and the run itself the time limit."""
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        seen = {
            name: OmegaConf.to_container(
                compose("config", [f"hydra/launcher={name}"], return_hydra_config=True).hydra.launcher, resolve=False
            )
            for name in ("ray", "submitit", "submitit_local")
        }
        assert compose("config").time_limit is None
    assert {"num_cpus", "num_gpus"} <= seen["ray"]["ray"]["remote"].keys()
    for name in ("submitit", "submitit_local"):
        assert {"cpus_per_task", "gpus_per_node", "timeout_min"} <= seen[name].keys()


def sweep(directory, *overrides):
    return ["-m", *SETTINGS, f"hydra.sweep.dir={directory}", *overrides]


@needs("ray")
@pytest.mark.nightly
def test_a_sweep_on_ray_fills_directories_that_the_report_reads(tmp_path):
    arguments = sweep(tmp_path / "sweep", "hydra/launcher=ray", "algo=gctd3,td3", "seed=0,1")
    done = process("train", *arguments)
    assert done.returncode == 0, done.stderr
    runs = sorted(file.parent for file in (tmp_path / "sweep").rglob("progress.csv"))
    assert [str(run.relative_to(tmp_path / "sweep")) for run in runs] == ["gctd3/0", "gctd3/1", "td3/2", "td3/3"]
    assert all([int(row["frames"]) for row in rows(run)] == [80, 160, 240] for run in runs)
    done = process("report", f"runs={tmp_path / 'sweep'}", f"out={tmp_path / 'report'}", "episodes=2")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "report" / "index.html").is_file()


@needs("ray")
@pytest.mark.nightly
def test_a_run_that_fails_elsewhere_is_said_here(tmp_path):
    arguments = sweep(tmp_path / "sweep", "hydra/launcher=ray", "robot.feet=[nobody]", "seed=0,1")
    done = process("train", *arguments)
    assert done.returncode == 2
    assert "nobody" in done.stderr and "Traceback" not in done.stderr


@needs("submitit")
@pytest.mark.nightly
def test_a_preempted_run_of_submitit_resumes_by_itself(tmp_path):
    directory = tmp_path / "sweep"
    long = ["total_frames=2000", "evaluation.every=200", "checkpoint_every=0.2", "seed=0,1"]
    running = subprocess.Popen(
        [sys.executable, "-m", "gctd3.train", *sweep(directory, "hydra/launcher=submitit_local", *long)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    first = directory / "gctd3" / "0"
    deadline = time.monotonic() + 300
    while not list(first.glob("checkpoints/best-*")):
        assert time.monotonic() < deadline and running.poll() is None, "no checkpoint"
        time.sleep(0.1)
    # Slurm's signal before it takes a node away: USR2 to the job's process, which writes to this directory.
    holder = subprocess.run(["fuser", str(first / ".lock")], capture_output=True, text=True).stdout.split()
    assert len(holder) == 1
    subprocess.run(["kill", f"-{signal.SIGUSR2.value}", holder[0]], check=True)
    out, _ = running.communicate(timeout=600)
    assert running.returncode == 0, out
    for name in ("0", "1"):
        assert int(rows(directory / "gctd3" / name)[-1]["frames"]) == 2000
    logs = "".join(file.read_text() for file in (directory / ".submitit").rglob("*.out"))
    assert "preempt" in logs.lower() and "requeue" in logs.lower(), logs[-2000:]
    whole = json.dumps(rows(directory / "gctd3" / "0", drop=["wall_s"]))
    alone = tmp_path / "alone"
    assert process("train", *SETTINGS, *long[:-1], "seed=0", f"hydra.run.dir={alone}").returncode == 0
    assert json.dumps(rows(alone, drop=["wall_s"])) == whole


@pytest.mark.nightly
def test_a_time_limit_ends_the_session_and_resuming_ends_the_run(tmp_path, capsys):
    run = tmp_path / "run"
    assert command("train", *SETTINGS, f"hydra.run.dir={run}", "time_limit=0.000001") == 0
    assert f"Continue it:  python -m gctd3.train resume={run}" in capsys.readouterr().out
    assert not rows(run) if (run / "progress.csv").exists() else True
    assert command("train", f"resume={run}", "time_limit=null") == 0
    assert [int(row["frames"]) for row in rows(run)] == [80, 160, 240]
    assert "Continue it" not in capsys.readouterr().out
