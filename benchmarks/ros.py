"""Walks over ROS: in lock-step beside the walk without, and with the time of day; and what a subscriber counts.

    python benchmarks/ros.py [out=FILE.json] [middleware=ros1] [python=EXE] [run=DIR] [walks=3] [seconds=60]

Exports the policy of ``run`` (by default the shipped one), then lets ``gctd3.ros node=both`` walk: once in lock-step,
which has to be the walk without ROS to the bit, and ``walks`` times with the time of day. In ROS 1 a subscriber of its
own then counts the states of a robot that is put back to its start every few seconds, for ``seconds``, and compares the
topics that the master knows with the names of the contract; and, for the biped, the topics with ``names=paper`` and
``names=authors`` with those that the paper and its authors' program have. ``python`` is the interpreter of the nodes,
for an environment of ROS 2. Nothing else is to run on the machine.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from common import options, report

from gctd3.bridge.messages import TYPES, Topic
from gctd3.bridge.names import CLOCK, ENDED, Layout, layout_of
from gctd3.bridge.settings import Names
from gctd3.deploy.contract import read_contract
from gctd3.deploy.export import export_run
from gctd3.deploy.settings import ExportSettings
from gctd3.errors import ConfigError

if TYPE_CHECKING:
    from gctd3.bridge.ros1 import Ros1

SUMMARY = re.compile(r"The robot (?P<ended>.+?): (?P<distance>[\d.e-]+) m in (?P<steps>\d+) steps")
TIMES = re.compile(
    r"median (?P<p50>[\d.]+) ms, 99th percentile (?P<p99>[\d.]+) ms; commands late (?P<late>\d+), missed "
    r"(?P<missed>\d+), refused (?P<refused>\d+)"
)
WITHOUT = (
    "import json, sys; from gctd3.bridge.settings import RosSettings; from gctd3.bridge.simulator_node import "
    "run_without_ros as walk\nw = walk(RosSettings(policy=sys.argv[1], run=sys.argv[2] or None))\n"
    "print(json.dumps({'ended': w.ended, 'distance': w.distance, 'steps': w.steps}))"
)
SPEED, RATE = 0.05, 0.01  # allowed differences of the mean speed and of the rate of states, as shares
RESET_EVERY, LOOK, LEAVES = 5.0, 3.0, 15.0  # s
# Beside /clock and /walk_ended, which are gctd3's own (the paper's section 3.1, and the authors' program).
_SERVOS = ("waist_thighR", "waist_thighL", "thighR_shankR", "thighL_shankL", "shankR_footR", "shankL_footL")
_COMMANDS = {f"/{name}_position_controller/command": "std_msgs/Float64" for name in _SERVOS}
THEIRS = {
    "paper": {
        "/Joint_states": "sensor_msgs/JointState",
        "/FootR_contact": "std_msgs/Bool",
        "/FootL_contact": "std_msgs/Bool",
        **_COMMANDS,
    },
    "authors": {
        "/joint_states": "sensor_msgs/JointState",
        "/footR_contact_sensor_state": "gazebo_msgs/ContactsState",
        "/footL_contact_sensor_state": "gazebo_msgs/ContactsState",
        **_COMMANDS,
    },
}


def walk(python: str, *arguments: str) -> dict[str, object]:
    """Let both nodes walk, and return what they print."""
    done = subprocess.run([python, "-m", "gctd3.ros", *arguments], capture_output=True, text=True, check=False)
    ended, times = SUMMARY.search(done.stdout), TIMES.search(done.stdout)
    if ended is None or times is None:
        raise SystemExit(f"gctd3.ros {' '.join(arguments)} ended with {done.returncode}: {done.stderr.strip()}")
    return {
        "exit_code": done.returncode,
        "ended": ended["ended"],
        "distance": float(ended["distance"]),
        "steps": int(ended["steps"]),
        "round_trip_ms": {"p50": float(times["p50"]), "p99": float(times["p99"])},
        **{name: int(times[name]) for name in ("late", "missed", "refused")},
    }


@contextlib.contextmanager
def nodes(python: str, arguments: list[str]) -> Iterator[None]:
    """Run both nodes in processes of their own."""
    started = [
        subprocess.Popen([python, "-m", "gctd3.ros", f"node={node}", *arguments]) for node in ("policy", "simulator")
    ]
    try:
        yield
    finally:
        # They take leave of the master, which would go on to list their topics.
        for process in started:
            process.terminate()
        for process in started:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(LEAVES)
            process.kill()
            process.wait()


def listen(link: Ros1, python: str, file: Path, run: str, names: Names, seconds: float) -> dict[str, object]:
    """Count the states on their topic with a subscriber of its own, and list the topics with their types, in ROS 1."""
    import rospy
    from std_srvs.srv import Empty

    layout = layout_of(read_contract(file.with_suffix(".json")), names)
    arguments = [f"policy={file}", "middleware=ros1", "clock=wall", f"names={names}", *([f"run={run}"] if run else [])]
    while link.receive(0.0) is not None:
        pass
    with nodes(python, arguments):
        rospy.wait_for_service(layout.services[0], timeout=60.0)
        reset = rospy.ServiceProxy(layout.services[0], Empty)
        while (item := link.receive(60.0)) is not None and item[0] != layout.joints:
            pass
        if item is None:
            raise SystemExit("no states within a minute")
        began = again = time.monotonic()
        stamps = []
        while (now := time.monotonic()) - began < seconds:
            if now - again > RESET_EVERY:
                reset()
                again = now
            item = link.receive(0.1)
            if item is not None and item[0] == layout.joints:
                stamps.append(item[1].stamp / 1e9)
        found = dict(sorted(rospy.get_published_topics()))
    return {
        "seconds": seconds,
        "states": len(stamps),
        "rate_hz": (len(stamps) - 1) / (stamps[-1] - stamps[0]),
        "topics": found,
        "topics_expected": expected(layout, names),
    }


def expected(layout: Layout, names: Names) -> dict[str, str]:
    """Return the type of each topic that both nodes publish, in order."""
    own = {topic.name: TYPES[topic.kind] for topic in (CLOCK, ENDED)}
    contract = {topic.name: TYPES[topic.kind] for topic in (*layout.sensors, *layout.commands)}
    return dict(sorted({**own, **THEIRS.get(names, contract)}.items()))


def count(python: str, file: Path, run: str, seconds: float) -> dict[str, dict[str, object]]:
    """Return what a subscriber counts and sees with each of the names that fit the robot, in ROS 1."""
    from gctd3.bridge.middleware import choose
    from gctd3.bridge.ros1 import Ros1, start_master

    choose("ros1")
    master = start_master(None)
    counted = {}
    with Ros1("listener", None) as link:
        link.subscribe([Topic(name, "joints") for name in ("/joint_states", "/Joint_states")])
        for names in ("contract", "paper", "authors"):
            # The last two are the biped's.
            with contextlib.suppress(ConfigError):
                counted[names] = listen(link, python, file, run, names, seconds if names == "contract" else LOOK)
    master.stop()
    return counted


def main() -> None:
    """Measure, print, write."""
    given = options(out="", middleware="ros1", python=sys.executable, run="", walks="3", seconds="60")
    os.environ["OMP_NUM_THREADS"] = "1"
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "policy.onnx"
        export_run(ExportSettings(run=given["run"] or None, out=str(file)))
        contract, python = read_contract(file.with_suffix(".json")), given["python"]
        arguments = [f"policy={file}", f"middleware={given['middleware']}"]
        arguments += [f"run={given['run']}"] if given["run"] else []
        line = [python, "-c", WITHOUT, str(file), given["run"]]
        without = json.loads(subprocess.run(line, stdout=subprocess.PIPE, text=True, check=True).stdout)
        lockstep = walk(python, *arguments)
        wall = [walk(python, *arguments, "clock=wall") for _ in range(int(given["walks"]))]
        counted = count(python, file, given["run"], float(given["seconds"])) if given["middleware"] == "ros1" else None
    rate = contract.control_rate_hz

    def speed(one: dict[str, object]) -> float:
        return float(str(one["distance"])) / int(str(one["steps"])) * rate

    same = (lockstep["distance"], lockstep["steps"]) == (without["distance"], without["steps"])
    print(f"without ROS: {without['distance']!r} m in {without['steps']} steps, {speed(without):.3f} m/s")
    print(f"lock-step: {'the same to the bit' if same else lockstep}; round trip {lockstep['round_trip_ms']} ms")
    for one in wall:
        print(
            f"time of day: {one['distance']:.3f} m in {one['steps']} steps, {speed(one):.3f} m/s, round trip "
            f"{one['round_trip_ms']} ms; late {one['late']}, missed {one['missed']}, refused {one['refused']}"
        )
    kept = {
        "lockstep_is_the_walk_without": same and lockstep["refused"] == 0,
        "speed_within_5_percent": all(abs(speed(one) / speed(without) - 1) <= SPEED for one in wall),
    }
    if counted is not None:
        one = counted["contract"]
        print(f"a subscriber counted {one['states']} states in {one['seconds']:g} s, {one['rate_hz']:.3f} Hz")
        kept["rate_within_1_percent"] = abs(float(str(one["rate_hz"])) / rate - 1) <= RATE
        for names, seen in counted.items():
            kept[f"topics_of_{names}"] = seen["topics"] == seen["topics_expected"]
    print("; ".join(f"{name}: {value}" for name, value in kept.items()))
    figures = {"without": without, "lockstep": lockstep, "wall": wall, "subscriber": counted, "kept": kept}
    report("ros", {"middleware": given["middleware"], **figures}, given["out"])
    raise SystemExit(0 if all(kept.values()) else 1)


if __name__ == "__main__":
    main()
