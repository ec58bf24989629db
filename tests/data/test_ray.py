"""Workers on a Ray cluster: an unfit cluster is refused at once; trainings on a cluster of this machine are slow."""

import contextlib
import importlib.util
import os
import signal
import socket
import subprocess
import sys
import time

import pytest
from running import command, process, rows, tiny
from workers import check_that_it_acts_with_the_weights_that_it_is_sent

from gctd3.data.ray_cluster import check_alike, check_room
from gctd3.data.settings import RaySettings
from gctd3.errors import ConfigError, WorkerError

RAY = ["collector=ray", "collector.chunk=2"]
needs_ray = pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="ray is not installed")


@pytest.mark.parametrize("address", ["somewhere", "ray://head:10001", "head:port", ""])
def test_an_address_that_is_none(address):
    with pytest.raises(ConfigError, match="address must be host:port, auto or null"):
        RaySettings(address=address)


def test_workers_must_fit_on_the_nodes():
    # 3 + 1 workers of 2 CPUs; the odd CPU of each node is of no use.
    check_room(4, 2, {"a": 7, "b": 3})
    with pytest.raises(ConfigError, match=r"workers=5 with collector.cpus=2 need 10 CPUs.*room for 4 \(a: 7, b: 3\)"):
        check_room(5, 2, {"b": 3, "a": 7})


def test_nodes_must_have_the_same_versions():
    here = {"torch": "2.13.0", "gctd3": "0.1.0"}
    check_alike(here, {"a": dict(here), "b": dict(here)})
    with pytest.raises(WorkerError, match=r"gctd3 none on b, 0.1.0 here; torch 2.12.0 on c, 2.13.0 here\.$"):
        check_alike(here, {"a": here, "c": {**here, "torch": "2.12.0"}, "b": {"torch": "2.13.0"}})


def test_without_ray_it_says_what_to_install(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("gctd3.data.ray_cluster.find_spec", lambda name: None)
    assert command("train", *tiny(tmp_path / "run", *RAY)) == 2
    assert "collector=ray needs its package: pip install 'gctd3[ray]'" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


@needs_ray
def test_a_wrong_address_is_said_within_seconds(tmp_path):
    began = time.monotonic()
    done = process("train", *tiny(tmp_path / "run", *RAY, f"collector.address=127.0.0.1:{free_port()}"))
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert "nothing answers there" in done.stderr and "ray start --head" in done.stderr
    assert not (tmp_path / "run").exists()
    # Most of it is the start of Python; a paused machine may take longer.
    assert time.monotonic() - began < 120


@pytest.fixture
def head(monkeypatch):
    """Return a function that starts a head node and returns its address; everything ends with the test."""
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")  # also for processes that join
    ray = [sys.executable, "-m", "ray.scripts.scripts"]
    started = []

    def start(cpus, **environment):
        port = free_port()
        line = [*ray, "start", "--head", "--block", f"--port={port}", f"--num-cpus={cpus}"]
        line += ["--include-dashboard=false", "--disable-usage-stats", f"--temp-dir=/tmp/ray-{os.getpid()}-{port}"]
        node = subprocess.Popen(
            line,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            env={**os.environ, **environment},
        )
        started.append(node)
        deadline = time.monotonic() + 120
        while time.monotonic() < deadline:
            with socket.socket() as client:
                if client.connect_ex(("127.0.0.1", port)) == 0:
                    time.sleep(5.0)  # its other processes
                    return node, f"127.0.0.1:{port}"
            time.sleep(0.2)
        raise AssertionError("no head node")

    yield start
    for node in started:
        kill_session(node.pid)
        node.wait()


def kill_session(leader):
    """Kill all processes of a session that the test began."""
    found = subprocess.run(["pgrep", "-s", str(leader)], capture_output=True, text=True).stdout.split()
    for pid in map(int, found):
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


@needs_ray
@pytest.mark.nightly
def test_a_worker_on_ray_acts_with_the_weights_that_it_is_sent(robot):
    import ray

    from gctd3.data.ray_worker import RayWorker

    RaySettings(workers=1).check_here(5)
    try:
        worker, _ = check_that_it_acts_with_the_weights_that_it_is_sent(RayWorker, robot)
        actors = list(worker._collector.remote_collectors)
        worker.kill()
        assert len(actors) == 1 and worker._collector.remote_collectors == []
        # Ray does not wait for the end of what it kills.
        with pytest.raises(ray.exceptions.RayActorError):
            for _ in range(100):
                ray.get(actors[0].__ray_call__.remote(lambda actor: 0))
                time.sleep(0.1)
        worker.close()
    finally:
        ray.shutdown()


STRIKING = """
import os, signal, sys
import ray
from gctd3 import train
from gctd3.training import trainer
class Striking(trainer.Trainer):
    def _learn(self, bar, seen):
        super()._learn(bar, seen)
        for frames, number, fault in ((96, 0, signal.SIGKILL), (160, 1, signal.SIGSTOP)):
            if self.counters.frames == frames:
                (actor,) = self.collector._slots[number].worker._collector.remote_collectors
                os.kill(ray.get(actor.__ray_call__.remote(lambda actor: os.getpid())), fault)
trainer.Trainer = Striking
sys.argv = ["train", *{arguments!r}]
train.main()
"""


@needs_ray
@pytest.mark.nightly
def test_a_cluster_starts_by_itself_and_its_workers_are_replaced(tmp_path):
    run = tmp_path / "run"
    code = STRIKING.format(arguments=tiny(run, *RAY, "collector.timeout=10"))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert "Worker 0 failed" in done.stderr and "Worker 1 has delivered nothing for 10 s" in done.stderr
    assert done.stderr.count("another takes its place") == 2
    assert [int(row["frames"]) for row in rows(run)] == [80, 160, 240]
    done = process("train", f"resume={run}", "total_frames=320")
    assert done.returncode == 0, done.stderr
    assert [int(row["frames"]) for row in rows(run)] == [80, 160, 240, 320]


@needs_ray
@pytest.mark.nightly
def test_a_running_cluster_is_joined_and_its_end_leaves_a_checkpoint(tmp_path, head):
    node, address = head(2)
    run = tmp_path / "run"
    long = tiny(run, *RAY, "total_frames=400_000", "evaluation.every=400_000", "checkpoint_every=0.5")
    joined = subprocess.Popen(
        [sys.executable, "-m", "gctd3.train", *long, f"collector.address={address}", "collector.max_restarts=1"],
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        deadline = time.monotonic() + 300
        while not list(run.glob("checkpoints/step-*")):
            assert time.monotonic() < deadline and joined.poll() is None, "no checkpoint"
            time.sleep(0.1)
        kill_session(node.pid)
        _, error = joined.communicate(timeout=300)
    finally:
        joined.kill()
    assert joined.returncode != 0, error
    reached = max(int(file.name.removeprefix("step-")) for file in run.glob("checkpoints/step-*"))
    done = process("train", f"resume={run}", "collector.address=null", f"total_frames={reached + 400}")
    assert done.returncode == 0, done.stderr
    assert reached < max(int(file.name.removeprefix("step-")) for file in run.glob("checkpoints/step-*"))


@needs_ray
@pytest.mark.nightly
@pytest.mark.parametrize("wrong", ["too few CPUs", "another version", "no Ray"])
def test_an_unfit_cluster_is_refused_with_its_reason(tmp_path, head, wrong):
    other = tmp_path / "site" / "mujoco-0.0.1.dist-info"
    other.mkdir(parents=True)
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: mujoco\nVersion: 0.0.1\n")
    with socket.create_server(("127.0.0.1", 0)) as silent:  # accepts connections and never answers
        address = f"127.0.0.1:{silent.getsockname()[1]}"
        if wrong != "no Ray":
            site = {"PYTHONPATH": str(tmp_path / "site")} if wrong == "another version" else {}
            _, address = head(1 if wrong == "too few CPUs" else 2, **site)
        done = process("train", *tiny(tmp_path / "run", *RAY, f"collector.address={address}"))
    assert done.returncode == 2 and "Traceback" not in done.stderr, done.stderr
    said = {
        "too few CPUs": "room for 1",
        "another version": "mujoco 0.0.1 on ",
        "no Ray": "no Ray cluster has answered there",
    }
    assert said[wrong] in done.stderr
    assert not (tmp_path / "run").exists()
