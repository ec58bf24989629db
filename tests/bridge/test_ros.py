"""The nodes over real ROS: a roscore with rospy, and rclpy. Two processes, and nothing that was made up."""

import contextlib
import json
import os
import socket
import subprocess
import sys
import threading
import time
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest
from ros_nodes import ROS2_PYTHON, Master, Process, needs_ros1, needs_ros2, once, quiet, walked

from gctd3.bridge.middleware import choose, find_ros1
from gctd3.bridge.names import layout_of
from gctd3.bridge.network import choose_for
from gctd3.bridge.settings import RosSettings
from gctd3.bridge.simulator_node import run_without_ros
from gctd3.deploy.contract import read_contract
from gctd3.errors import MiddlewareError

pytest.importorskip("onnxruntime")
SOON = 3.0  # within which a failure is said (s)
LIGHT = """
import importlib.abc, sys
class Refuse(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {heavy}:
            raise ImportError(f"{{name}} is not for a robot")
sys.meta_path.insert(0, Refuse())
sys.argv = ["gctd3.ros", *sys.argv[1:]]
import gctd3.ros
try:
    gctd3.ros.main()
finally:
    print("loaded", sorted({heavy} & {{name.split(".")[0] for name in sys.modules}}), file=sys.stderr)
"""
HEAVY = {"torch", "torchrl", "tensordict", "mujoco", "hydra", "omegaconf", "gymnasium", "dm_control", "safetensors"}


def alone(exported, **settings):
    """Return distance, steps and refusals of the walk without ROS."""
    walk = run_without_ros(RosSettings(policy=str(exported), **settings))
    return walk.distance, walk.steps, 0


@needs_ros1
def test_a_short_walk_over_a_roscore_is_the_one_without(exported):
    done = once(f"policy={exported}", "middleware=ros1", "seconds=0.5")
    assert done.returncode == 0, done.stderr
    assert walked(done.stdout) == alone(exported, seconds=0.5)
    assert "policy: 25 steps, 0 refused" in done.stdout


@needs_ros1
@pytest.mark.nightly
@pytest.mark.parametrize("names", ["contract", "paper", "authors"])
def test_ros1_walks_to_the_finish_as_without_to_the_bit(exported, names):
    done = once(f"policy={exported}", "middleware=ros1", f"names={names}")
    assert done.returncode == 0, done.stderr
    distance, steps, refused = walked(done.stdout)
    assert (distance, steps, refused) == alone(exported) and distance >= 15.0


@needs_ros2
@pytest.mark.nightly
@pytest.mark.parametrize("names", ["contract", "paper"])
def test_ros2_walks_to_the_finish_as_without_to_the_bit(exported, names):
    done = once(f"policy={exported}", "middleware=ros2", f"names={names}", python=ROS2_PYTHON)
    assert done.returncode == 0, done.stderr
    code = (
        "import json, sys; from gctd3.bridge.settings import RosSettings; import gctd3.bridge.simulator_node as s\n"
        "walk = s.run_without_ros(RosSettings(policy=sys.argv[1])); print(json.dumps([walk.distance, walk.steps, 0]))"
    )
    without = subprocess.run([ROS2_PYTHON, "-c", code, exported], capture_output=True, text=True, check=True)
    assert list(walked(done.stdout)) == json.loads(without.stdout)


@needs_ros2
@pytest.mark.nightly
@pytest.mark.parametrize("killed", ["policy", "simulator"])
def test_of_ros2_a_killed_node_ends_the_other(exported, tmp_path, killed):
    arguments = [f"policy={exported}", "middleware=ros2", "seconds=600"]
    nodes = {
        name: Process(tmp_path, f"node={name}", *arguments, python=ROS2_PYTHON, ROS_DOMAIN_ID="77")
        for name in ("policy", "simulator")
    }
    _one_dies(nodes, killed)


@needs_ros1
@pytest.mark.nightly
def test_the_policys_node_imports_nothing_heavy(exported, tmp_path):
    """PyTorch, MuJoCo and Hydra cannot be imported where it runs, and none of them is asked for."""
    with Master() as there:
        simulator = Process(tmp_path, "node=simulator", f"policy={exported}", "seconds=1", **there)
        line = [sys.executable, "-c", LIGHT.format(heavy=HEAVY), "node=policy", f"policy={exported}"]
        done = subprocess.run(line, capture_output=True, text=True, env=quiet(**there), timeout=90)
        assert simulator.end() == 0, simulator.said
    assert done.stderr.endswith("loaded []\n") and "policy: 50 steps, 0 refused" in done.stdout, done.stderr


def test_the_policys_node_needs_nothing_heavy_to_be_imported():
    """As the test with a roscore, for those who have none."""
    code = f"import gctd3.ros, gctd3.bridge.policy_node, gctd3.bridge.arguments, sys; print({HEAVY} & set(sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "set()\n"


# What goes wrong.


def _one_dies(nodes, killed):
    """Kill a node in the middle of a walk: the other one says so within three seconds, and ends with an error."""
    other = nodes["simulator" if killed == "policy" else "policy"]
    try:
        for node in nodes.values():
            node.until("Connected")
        time.sleep(1.0)
        nodes[killed].kill()
        began = time.monotonic()
        line = "No good command for" if killed == "policy" else "No good readings for"
        assert other.until(line) - began < SOON
        assert other.end() == 1
        assert "safe command" in other.said and "Traceback" not in other.said
        if killed == "simulator":
            assert "phase 'home'" in other.said
    finally:
        for node in nodes.values():
            node.kill()


@needs_ros1
@pytest.mark.nightly
@pytest.mark.parametrize("clock", ["lockstep", "wall"])
@pytest.mark.parametrize("killed", ["policy", "simulator"])
def test_a_killed_node_ends_the_other(exported, tmp_path, killed, clock):
    with Master() as there:
        arguments = [f"policy={exported}", "middleware=ros1", f"clock={clock}", "seconds=600"]
        _one_dies({n: Process(tmp_path, f"node={n}", *arguments, **there) for n in ("policy", "simulator")}, killed)


@needs_ros1
@pytest.mark.nightly
@pytest.mark.parametrize("node", ["policy", "simulator"])
def test_without_a_master(exported, node):
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        uri = f"http://127.0.0.1:{probe.getsockname()[1]}"
    done = once(f"node={node}", f"policy={exported}", "middleware=ros1", ROS_MASTER_URI=uri)
    assert done.returncode == 1
    assert done.stderr.startswith(f"error: There is no ROS master at {uri}") and "start roscore" in done.stderr
    assert done.stderr.count("\n") == 1


class Silent(BaseHTTPRequestHandler):
    """Answer as no master does."""

    def log_message(self, *_):
        """Write nothing."""


@needs_ros1
@pytest.mark.nightly
def test_what_is_no_master(exported):
    server = HTTPServer(("127.0.0.1", 0), Silent)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    uri = f"http://127.0.0.1:{server.server_port}"
    done = once("node=policy", f"policy={exported}", "middleware=ros1", ROS_MASTER_URI=uri)
    server.shutdown()
    server.server_close()
    assert (done.returncode, done.stderr.count("\n")) == (
        1,
        1,
    ) and f"What answers at {uri} is no ROS master" in done.stderr


def own_address():
    """Return an address of this machine that is not the loopback one, if it has one."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))
        except OSError:
            return None
        return probe.getsockname()[0]


@needs_ros1
@pytest.mark.nightly
def test_a_master_elsewhere(exported):
    """A node that listens on the loopback address only is not reached from where the master is."""
    address = own_address()
    if address is None or address.startswith("127."):
        pytest.skip("this machine has no network")
    with Master(address) as there:
        done = once("node=policy", f"policy={exported}", "middleware=ros1", **there)
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert (
        f"The master at {there['ROS_MASTER_URI']} is elsewhere, and this node listens at 127.0.0.1 only" in done.stderr
    )


@needs_ros1
@pytest.mark.nightly
def test_an_address_that_does_not_resolve(exported):
    done = once(f"policy={exported}", "middleware=ros1", ROS_HOSTNAME="nowhere.invalid")
    assert done.returncode == 1
    assert done.stderr.startswith("error: ROS_HOSTNAME=nowhere.invalid: this address cannot be resolved")


@needs_ros1
@pytest.mark.nightly
def test_everything_listens_on_the_loopback_address(exported, tmp_path):
    """Master, policy and simulator: no socket of theirs listens anywhere else."""
    both = Process(tmp_path, f"policy={exported}", "middleware=ros1", "clock=wall", "seconds=60")
    try:
        both.until("simulator: Connected")
        both.until("policy: Connected")
        mine = [both.process.pid, *children(both.process.pid)]
        found = [address for pid in mine for address in listening(pid)]
        assert len(mine) == 2 and len(found) >= 5 and {address[:3] for address in found} == {"127"}
    finally:
        for pid in children(both.process.pid):
            subprocess.run(["kill", "-9", str(pid)], check=False)
        both.kill()


def children(pid):
    with open(f"/proc/{pid}/task/{pid}/children") as file:
        return [int(word) for word in file.read().split()]


def listening(pid):
    """Return the addresses at which a process listens for TCP."""
    inodes = set()
    for fd in os.listdir(f"/proc/{pid}/fd"):
        # One that is closed meanwhile listens no more.
        with contextlib.suppress(OSError):
            inodes.add(os.readlink(f"/proc/{pid}/fd/{fd}"))
    found = []
    for table in ("tcp", "tcp6"):
        with open(f"/proc/{pid}/net/{table}") as file:
            for row in list(file)[1:]:
                words = row.split()
                if words[3] == "0A" and f"socket:[{words[9]}]" in inodes:
                    digits = words[1].split(":")[0]
                    raw = bytes.fromhex(digits)[::-1] if table == "tcp" else bytes.fromhex(digits)
                    found.append(".".join(map(str, raw)) if table == "tcp" else f"[{raw.hex()}]")
    return found


def test_what_is_missing_is_said(monkeypatch, tmp_path):
    """Without ROS: the line that brings it; with packages of another Python: that."""
    monkeypatch.setattr("gctd3.bridge.middleware.find_spec", lambda name: None)
    monkeypatch.setattr("gctd3.bridge.middleware.DEBIAN", tmp_path)
    with pytest.raises(
        MiddlewareError, match=r"ROS 1 needs rospy: apt-get install .*; or ROS 2 needs rclpy: pip install"
    ):
        choose("auto")
    with pytest.raises(MiddlewareError, match=r"^ROS 2 needs rclpy: pip install 'gctd3\[ros2\]', in an environment"):
        choose("ros2")
    (tmp_path / "rospy").mkdir()
    (tmp_path / "python3.4").touch()
    monkeypatch.setattr("gctd3.bridge.middleware.DEBIAN_PYTHON", tmp_path / "python3.4")
    assert "is for Python 3.4, and this is 3." in find_ros1()
    monkeypatch.setattr("gctd3.bridge.middleware.find_spec", lambda name: "there" if name == "rclpy" else None)
    assert "this environment has ROS 2" in find_ros1() and choose("auto") == "ros2"


def test_what_ros2_has_no_type_for(exported, monkeypatch):
    contract = read_contract(exported.with_suffix(".json"))
    monkeypatch.setattr("gctd3.bridge.middleware.find_spec", lambda name: "there")
    monkeypatch.setattr("gctd3.bridge.network.find_spec", lambda name: None)
    with pytest.raises(MiddlewareError, match=r"^names=authors .* gazebo_msgs/ContactsState, .*: names=paper sends"):
        choose_for("ros2", layout_of(contract, "authors"))
    assert [choose_for("ros2", layout_of(contract, names)) for names in ("paper", "contract")] == ["ros2"] * 2
    assert choose_for("ros1", layout_of(contract, "authors")) == "ros1"
    monkeypatch.setattr("gctd3.bridge.network.find_spec", lambda name: "there")
    assert choose_for("ros2", layout_of(contract, "authors")) == "ros2"


@needs_ros2
@pytest.mark.nightly
@pytest.mark.parametrize("node", ["both", "policy", "simulator"])
def test_of_ros2_the_authors_contacts_are_refused_in_a_line(exported, node):
    has = "import importlib.util, sys; sys.exit(importlib.util.find_spec('gazebo_msgs') is not None)"
    if subprocess.run([ROS2_PYTHON, "-c", has]).returncode:
        pytest.skip("this ROS 2 has gazebo_msgs")
    done = once(f"node={node}", f"policy={exported}", "middleware=ros2", "names=authors", python=ROS2_PYTHON)
    assert done.returncode == 1 and done.stderr.startswith("error: names=authors sends the feet's contacts as gazebo")
    assert done.stderr.count("\n") == 1


ROGUE = """
import sys, time
from dataclasses import replace
from pathlib import Path
from gctd3.bridge.middleware import choose
from gctd3.bridge.names import layout_of
from gctd3.deploy.contract import read_contract
side, kind, file = sys.argv[1:]
choose("ros1")
from gctd3.bridge.ros1 import Ros1
contract = read_contract(Path(file).with_suffix(".json"))
layout = layout_of(contract, "contract")
link = Ros1("rogue", None)
link.advertise(layout.sensors if side == "simulator" else layout.commands)
link.subscribe(layout.commands if side == "simulator" else layout.sensors)
link.meet([*layout.sensors, *layout.commands], 60.0, print)
still = {name: 0.0 for name in (*contract.readings, "distance_m")}
if side == "simulator":
    for topic, message in layout.pack_readings(10**9, "", still):
        link.publish(topic, message)
    good = link.receive(10.0)[1].positions
    stamp = 10**9 + (0 if kind == "stale" else 20_000_000)
    for topic, message in layout.pack_readings(stamp, "", still):
        short = topic == layout.joints and kind == "short"
        link.publish(topic, replace(message, positions=(0.0,)) if short else message)
    first = link.receive(10.0)[1].positions
    print("held" if first == good else (first, good), flush=True)
    last = first
    while (item := link.receive(3.0)) is not None:
        last = item[1].positions
    print("home" if last == tuple(servo.home_rad for servo in contract.servos) else last, flush=True)
else:
    while (item := link.receive(10.0))[0] != layout.joints:
        pass
    stamp = item[1].stamp - (20_000_000 if kind == "stale" else 0)
    ((topic, message),) = layout.pack_command(stamp, "", {s.actuator: 0.3 for s in contract.servos})
    link.publish(topic, message if kind == "stale" else replace(message, positions=(0.3,)))
    time.sleep(3.0)
link.close()
"""


@needs_ros1
@pytest.mark.nightly
@pytest.mark.parametrize("kind", ["stale", "short"])
@pytest.mark.parametrize("rogue", ["policy", "simulator"])
def test_a_bad_message_over_a_roscore(exported, tmp_path, rogue, kind):
    """It is refused with a line within three seconds; the safe command follows, and an error ends the node."""
    with Master() as there:
        node = Process(
            tmp_path, f"node={'simulator' if rogue == 'policy' else 'policy'}", f"policy={exported}", **there
        )
        line = [sys.executable, "-c", ROGUE, rogue, kind, str(exported)]
        with subprocess.Popen(line, stdout=subprocess.PIPE, text=True, env=quiet(**there)) as other:
            connected = node.until("Connected")
            assert node.until("Refused: ") - connected < SOON
            assert node.end() == 1
            said = other.communicate(timeout=60)[0]
    assert {"stale": "tale", "short": "positions, expected as many of both"}[kind] in node.said
    assert "phase 'home'" in node.said and "Traceback" not in node.said
    assert rogue == "policy" or said.split() == ["held", "home"]
