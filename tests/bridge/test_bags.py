"""Bags of a walk are read back by rosbags, and by ROS itself, as what was simulated."""

import csv
import subprocess

import numpy as np
import pytest
from ros_nodes import DEBIAN_PYTHON, ROS1, needs_ros1
from running import command

from gctd3.errors import ConfigError
from gctd3.runs.settings import EvaluateSettings

pytest.importorskip("rosbags", reason="pip install 'gctd3[bags]'")


def read(file):
    """Return the times (s) and the messages of each topic."""
    from rosbags.highlevel import AnyReader

    found = {}
    with AnyReader([file]) as reader:
        for connection, time, content in reader.messages():
            message = reader.deserialize(content, connection.msgtype)
            found.setdefault(connection.topic, []).append((time / 1e9, message))
    return found


@pytest.fixture(scope="module", params=[pytest.param(".bag", marks=pytest.mark.nightly), ".mcap"])
def made(request, tmp_path_factory):
    """Return the folder of an evaluation with a bag, and the bag."""
    folder = tmp_path_factory.mktemp("bag")
    file = folder / f"a walk{request.param}"
    assert command("evaluate", "episodes=1", "threads=1", f"out={folder}", f"bag='{file}'") == 0
    return folder, file


@pytest.mark.nightly
def test_a_bag_holds_the_typical_episode(made):
    """The same motion as trace.csv, with its six digits; desired angles one control period before the states."""
    folder, file = made
    found = read(file)
    rows = list(csv.DictReader((folder / "trace.csv").read_text().splitlines()))
    trace = {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}
    states = [message for _, message in found["/joint_states"]]
    assert len(states) == len(rows) == len(found["/joint_command"]) == len(found["/clock"])
    for i, name in enumerate(states[0].name):
        for key, column in ((f"angle_{name}_rad", "position"), (f"velocity_{name}_rad_s", "velocity")):
            values = np.array([getattr(state, column)[i] for state in states])
            np.testing.assert_allclose(values, trace[key], rtol=1e-5, atol=1e-9)
    for topic, key in (("/height_m", "height_m"), ("/velocity_m_s", "velocity_m_s")):
        np.testing.assert_allclose([m.data for _, m in found[topic]], trace[key], rtol=1e-5, atol=1e-7)
    for foot in ("foot_right", "foot_left"):
        assert [m.data for _, m in found[f"/down_{foot}"]] == trace[f"down_{foot}"].astype(bool).tolist()
    times = np.array([time for time, _ in found["/joint_states"]])
    np.testing.assert_allclose(times - 1.0, trace["time_s"], atol=1e-9)
    np.testing.assert_allclose([time for time, _ in found["/joint_command"]], times - 0.02, atol=1e-9)
    stamps = [state.header.stamp.sec + state.header.stamp.nanosec / 1e9 for state in states]
    np.testing.assert_allclose(stamps, times, atol=1e-9)
    # A servo follows its command, so that they are of one joint.
    desired = np.array([m.position for _, m in found["/joint_command"]])
    angles = np.array([state.position for state in states])
    assert list(found["/joint_command"][0][1].name) == list(states[0].name)
    assert all(np.corrcoef(desired[:, i], angles[:, i])[0, 1] > 0.3 for i in range(desired.shape[1]))


@needs_ros1
@pytest.mark.nightly
def test_ros_itself_reads_the_bag(made):
    if not (ROS1 / "rosbag").is_dir():
        pytest.skip("apt-get install -y --no-install-recommends python3-rosbag")
    folder, file = made
    if file.suffix != ".bag":
        pytest.skip("rosbag is of ROS 1")
    code = "import sys, rosbag; sys.argv = ['rosbag', 'info', sys.argv[1]]; rosbag.rosbagmain()"
    done = subprocess.run([DEBIAN_PYTHON, "-c", code, file], capture_output=True, text=True, env={"PATH": "/usr/bin"})
    steps = len((folder / "trace.csv").read_text().splitlines()) - 1
    assert done.returncode == 0, done.stderr
    for line in (f"/joint_states      {steps} msgs    : sensor_msgs/JointState", f"messages:    {steps * 7}"):
        assert line in done.stdout, done.stdout


@pytest.mark.parametrize(
    "given, said",
    [
        ("walk.csv", r"bag must end in .bag \(ROS 1\) or .mcap \(ROS 2\), got 'walk.csv'"),
        ("nowhere/walk.bag", "bag=nowhere/walk.bag: there is no folder"),
    ],
)
def test_another_file_is_refused(given, said):
    with pytest.raises(ConfigError, match=said):
        EvaluateSettings(bag=given)


def test_without_rosbags_the_line_that_brings_it(monkeypatch):
    monkeypatch.setattr("gctd3.runs.settings.find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"A bag needs rosbags: pip install 'gctd3\[bags\]'"):
        EvaluateSettings(bag="walk.bag")
