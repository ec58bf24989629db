"""Inertial readings in sensor_msgs/Imu: against turns by hand, MuJoCo's rotations, and the types of ROS themselves."""

import json
import math
import subprocess
import time
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from loopback import Hub, Loopback, Task
from ros_nodes import ROS2_PYTHON, needs_ros1, needs_ros2, once, walked

from gctd3.bridge.inertial import orientation_of, unpack_inertial, vertical
from gctd3.bridge.messages import ImuSample, MessageError
from gctd3.bridge.names import ENDED, IMU, layout_of
from gctd3.bridge.plant import plant_of
from gctd3.bridge.policy_node import PolicyNode
from gctd3.bridge.settings import RosSettings
from gctd3.bridge.simulator_node import SimulatorNode, run_without_ros
from gctd3.deploy.contract import read_contract
from gctd3.deploy.policy import Policy

GRAVITY = ("gravity_forward", "gravity_side", "gravity_up")
ANGLES, RATES = ("roll_rad", "pitch_rad"), ("roll_rate_rad_s", "pitch_rate_rad_s", "yaw_rate_rad_s")
HALF = math.sqrt(0.5)


@pytest.fixture(scope="module")
def contract(exported_velocity):
    return read_contract(exported_velocity.with_suffix(".json"))


@pytest.fixture
def plant(finished, contract):
    return plant_of(str(finished["velocity"]), contract, None, None)


def read(orientation, *names):
    found = unpack_inertial(IMU, ImuSample(0, "", orientation, (1.0, 2.0, 3.0)), names)
    return [found[name] for name in names]


@pytest.mark.parametrize(
    "turn, quaternion, gravity",
    [
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, -1.0)),
        # A body on its right side: what is to its left is up.
        ((math.pi / 2, 0.0, 0.0), (HALF, 0.0, 0.0, HALF), (0.0, -1.0, 0.0)),
        # One that stands on its nose: what is in front of it is down.
        ((0.0, math.pi / 2, 0.0), (0.0, HALF, 0.0, HALF), (1.0, 0.0, 0.0)),
        # One that has turned to the left is as upright as before.
        ((0.0, 0.0, math.pi / 2), (0.0, 0.0, HALF, HALF), (0.0, 0.0, -1.0)),
        # Nose down by 30 degrees, whatever its heading.
        ((0.0, math.pi / 6, 0.0), (0.0, math.sin(math.pi / 12), 0.0, math.cos(math.pi / 12)), (0.5, 0.0, -(0.75**0.5))),
    ],
)
def test_turns_by_hand(turn, quaternion, gravity):
    assert orientation_of(*turn) == pytest.approx(quaternion, abs=1e-15)
    assert read(quaternion, *GRAVITY) == pytest.approx(gravity, abs=1e-15)
    assert read(quaternion, *RATES) == [1.0, 2.0, 3.0]
    # The negative quaternion is the same rotation.
    assert read(tuple(-q for q in quaternion), *GRAVITY) == pytest.approx(gravity, abs=1e-15)


def test_any_turn_is_that_of_mujoco():
    """MuJoCo turns by yaw, then pitch, then roll; angles and gravity's direction are read back from the quaternion."""
    rng, made, matrix = np.random.default_rng(0), np.zeros(4), np.zeros(9)
    for roll, pitch, yaw in rng.uniform(-1, 1, (100, 3)) * [math.pi, 1.5, math.pi]:
        mujoco.mju_euler2Quat(made, np.array([yaw, pitch, roll]), "zyx")
        ours = np.roll(orientation_of(roll, pitch, yaw), 1)
        assert min(abs(ours - made).max(), abs(ours + made).max()) < 1e-15
        mujoco.mju_quat2Mat(matrix, made)
        orientation = tuple(np.roll(made, -1).tolist())
        assert vertical(orientation) == pytest.approx(matrix[6:], abs=1e-15)
        assert read(orientation, *GRAVITY) == pytest.approx(-matrix[6:], abs=1e-14)
        assert read(orientation, *ANGLES) == pytest.approx([roll, pitch], abs=1e-13)


@pytest.mark.nightly
def test_an_imu_takes_the_place_of_six_topics(contract):
    layout = layout_of(contract, "contract")
    assert set(layout.inertial) == {*GRAVITY, *RATES}
    names = [topic.name for topic in layout.sensors]
    assert names[-2:] == ["/imu/data", "/joint_states"] and not any("gravity" in n or "rate" in n for n in names)
    assert ("/imu/data", "simulator to policy", "sensor_msgs/Imu") in layout.table(True)


def test_a_moving_robot_is_read_as_the_task_reads_it(plant, contract):
    """To the bit of the policy's float32; and gravity's direction is the one of MuJoCo's quaternion."""
    layout, rng, matrix = layout_of(contract, "contract"), np.random.default_rng(0), np.zeros(9)
    assert plant.task.robot.base.axis == "x"
    start = plant._data
    start.qpos[3:7] = 0.8, 0.3, -0.4, 0.2
    start.qvel[3:6] = 1.0, -2.0, 3.0
    for _ in range(20):
        plant.step({servo.actuator: rng.uniform(servo.low_rad, servo.high_rad) for servo in contract.servos})
        expected, sample = plant.readings(), plant.imu(7)
        found = layout.unpack_reading(IMU, sample)
        assert set(found) == set(layout.inertial) and sample.stamp == 7 and sample.frame == "base_link"
        for name, value in found.items():
            assert value == pytest.approx(expected[name], abs=1e-14)
            # Where it is not 0 but for the rounding.
            assert abs(value) < 1e-9 or np.float32(value) == np.float32(expected[name])
        mujoco.mju_quat2Mat(matrix, plant.qpos[3:7])
        assert [found[name] for name in GRAVITY] == pytest.approx(-matrix[6:], abs=1e-12)
        assert [found[name] for name in RATES] == pytest.approx(plant._data.qvel[3:6], abs=1e-12)


@pytest.mark.parametrize("yaw", [0.0, math.pi / 2])
def test_accelerations_by_hand(plant, contract, yaw):
    """A robot at rest on a slope of 5 degrees measures the ground's force; one that falls freely measures nothing."""
    home, slope = {servo.actuator: servo.home_rad for servo in contract.servos}, math.radians(5)
    data, g = plant._data, 9.81
    data.qpos[3:7] = math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)
    # A slope down forward is a gravity that points forward.
    plant.model.opt.gravity[:] = g * math.sin(slope), 0.0, -g * math.cos(slope)
    for _ in range(150):
        plant.step(home)
    forward = -g * math.sin(slope)
    # Forward is to the right of one that has turned to the left.
    expected = (forward, 0.0, g * math.cos(slope)) if yaw == 0.0 else (0.0, -forward, g * math.cos(slope))
    assert plant.imu(0).linear_acceleration == pytest.approx(expected, abs=0.15)
    data.qpos[2] += 5.0
    data.qvel[:] = 0.0
    plant.step(home)
    assert plant.imu(0).linear_acceleration == pytest.approx((0.0, 0.0, 0.0), abs=0.15)


@pytest.mark.parametrize(
    "changed, said",
    [
        ({"orientation": None}, r"/imu/data has no orientation \(orientation_covariance\[0\] is -1\), from which this"),
        ({"orientation": (0.0,) * 4}, "/imu/data has an orientation of norm 0, expected a unit quaternion."),
        ({"orientation": (math.nan, 0.0, 0.0, 1.0)}, "/imu/data has an orientation of norm nan, expected a unit"),
        ({"angular_velocity": None}, r"/imu/data has no angular velocity .* reads roll_rate_rad_s"),
    ],
)
def test_what_an_imu_lacks_is_said(changed, said):
    sample = replace(ImuSample(0, "", (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0)), **changed)
    with pytest.raises(MessageError, match=said):
        unpack_inertial(IMU, sample, ("gravity_up", "roll_rate_rad_s"))


def test_a_gyroscope_alone_needs_no_orientation():
    sample = ImuSample(0, "", None, (0.1, 0.2, 0.3))
    assert unpack_inertial(IMU, sample, ("yaw_rate_rad_s",)) == {"yaw_rate_rad_s": 0.3}


def test_a_walk_over_messages_is_the_one_without(exported_velocity, finished, contract):
    """In lock-step, to the bit."""
    settings = RosSettings(policy=str(exported_velocity), run=str(finished["velocity"]), seconds=1.0)
    hub, layout = Hub(), layout_of(contract, "contract")
    task = Task(
        SimulatorNode(settings, plant_of(settings.run, contract, None, 1.0), Loopback(hub), layout).run,
    )
    follower = PolicyNode(settings, Policy(exported_velocity), Loopback(hub), layout)
    Task(follower.run)
    walk, alone = task.done(), run_without_ros(settings)
    assert walk.qpos.tolist() == alone.qpos.tolist() and walk.steps == alone.steps == len(hub.of("/imu/data"))


@pytest.mark.parametrize(
    "imu, said",
    [("silent", "Refused: /imu/data is silent."), ("stale", "Refused: /imu/data is stale: it is 0.0")],
)
def test_readings_of_another_control_period_are_refused(exported_velocity, contract, imu, said, capfd):
    """With the time of day: a unit that stops, and one whose messages are older than the joints' states."""
    hub, layout = Hub(), layout_of(contract, "contract")
    peer = Loopback(hub)
    peer.advertise([*layout.sensors, ENDED])
    peer.subscribe(layout.commands)
    settings = RosSettings(policy=str(exported_velocity), clock="wall", wait=5.0)
    follower = PolicyNode(settings, Policy(exported_velocity), Loopback(hub), layout)
    node, period = Task(follower.run), 1 / contract.control_rate_hz
    values = {feature.reading: (feature.low + feature.high) / 2 for feature in contract.features} | {"distance_m": 0.0}
    values |= {name: 0.0 for name in values if name.startswith("down_")}
    for step in range(8):
        stamp, wrong = time.time_ns(), step >= 3
        old = stamp - (round(3 * period * 1e9) if wrong and imu == "stale" else 0)
        sample = ImuSample(old, "base_link", (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
        for topic, message in layout.pack_readings(stamp, "", values, sample):
            if not (topic == IMU and wrong and imu == "silent"):
                peer.publish(topic, message)
        time.sleep(period)
    peer.publish(ENDED, "time")
    node.done()
    assert said in capfd.readouterr().err and follower.counts.steps >= 1 and follower.counts.refused >= 3


# The types of ROS.

SAMPLE = ImuSample(3_000_000_007, "base_link", (0.1, -0.2, 0.3, 0.9), (1.0, 2.0, 3.0), (0.5, -0.25, 9.8125))
FIELDS = """
def fields(message):
    parts = [(message.orientation, "xyzw"), (message.angular_velocity, "xyz"), (message.linear_acceleration, "xyz")]
    covariances = [getattr(message, f"{name}_covariance")[0] for name in
        ("orientation", "angular_velocity", "linear_acceleration")]
    return [[getattr(part, axis) for axis in axes] for part, axes in parts] + [list(map(float, covariances))]
"""
EXPECTED = [list(SAMPLE.orientation), list(SAMPLE.angular_velocity), list(SAMPLE.linear_acceleration), [0.0, 0.0, 0.0]]


@needs_ros1
def test_the_message_of_ros1():
    import genpy
    from sensor_msgs.msg import Imu

    from gctd3.bridge.packing import fill, plain
    from gctd3.bridge.ros1 import _nanoseconds

    space = {}
    exec(FIELDS, space)
    for sample in (SAMPLE, replace(SAMPLE, orientation=None, linear_acceleration=None)):
        made = fill(Imu(), "imu", sample, lambda ns: genpy.Time(*divmod(ns, 10**9)), None)
        assert plain("imu", made, _nanoseconds) == sample
        assert made.header.stamp.to_nsec() == sample.stamp and made._check_types() is None
        if sample is SAMPLE:
            assert space["fields"](made) == EXPECTED
        else:
            assert space["fields"](made)[3] == [-1.0, 0.0, -1.0]


@needs_ros2
@pytest.mark.nightly
def test_the_message_of_ros2():
    code = f"""
import json
from sensor_msgs.msg import Imu
from gctd3.bridge.messages import ImuSample
from gctd3.bridge.packing import fill, plain
from gctd3.bridge.ros2 import _nanoseconds, _time
{FIELDS}
sample = {SAMPLE!r}
made = fill(Imu(), "imu", sample, _time, None)
print(json.dumps([fields(made), plain("imu", made, _nanoseconds) == sample]))
"""
    done = subprocess.run([ROS2_PYTHON, "-c", code], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == [EXPECTED, True]


@pytest.mark.nightly
@pytest.mark.parametrize("middleware", [pytest.param("ros1", marks=needs_ros1), pytest.param("ros2", marks=needs_ros2)])
def test_a_free_robot_walks_over_ros_as_without_to_the_bit(exported_velocity, finished, middleware):
    """As far as an untrained policy gets; a fall is its exit code of 1."""
    arguments = [f"policy={exported_velocity}", f"run={finished['velocity']}", "seconds=1"]
    python = {"python": ROS2_PYTHON} if middleware == "ros2" else {}
    done = once(*arguments, f"middleware={middleware}", **python)
    assert "m in" in done.stdout, done.stderr
    distance, steps, refused = walked(done.stdout)
    if middleware == "ros1":
        settings = RosSettings(policy=str(exported_velocity), run=str(finished["velocity"]), seconds=1.0)
        alone = run_without_ros(settings)
        assert (distance, steps, refused) == (alone.distance, alone.steps, alone.refused)
    else:
        code = (
            "import json, sys\nfrom gctd3.bridge.settings import RosSettings\n"
            "import gctd3.bridge.simulator_node as node\n"
            "walk = node.run_without_ros(RosSettings(policy=sys.argv[1], run=sys.argv[2], seconds=1.0))\n"
            "print(json.dumps([walk.distance, walk.steps, walk.refused]))"
        )
        line = [ROS2_PYTHON, "-c", code, str(exported_velocity), str(finished["velocity"])]
        without = subprocess.run(line, capture_output=True, text=True, check=True)
        assert [distance, steps, refused] == json.loads(without.stdout)
