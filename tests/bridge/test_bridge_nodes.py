"""The policy's and the simulator's node, over a middleware within the process: what they do does not depend on ROS."""

import time
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from loopback import Hub, Loopback, Task

from gctd3.bridge.messages import ImuSample, JointSample, Topic, Velocity
from gctd3.bridge.names import CMD_VEL, ENDED, layout_of
from gctd3.bridge.policy_node import PolicyNode
from gctd3.bridge.settings import RosSettings
from gctd3.bridge.simulator_node import SimulatorNode, run_without_ros
from gctd3.deploy.contract import read_contract
from gctd3.deploy.policy import Policy
from gctd3.errors import MiddlewareError

pytest.importorskip("onnxruntime")
PERIOD = 0.02


def nodes(settings, hub=None):
    """Start both nodes, and return the hub and the two of them at work."""
    from gctd3.bridge.plant import plant_of

    hub = Hub() if hub is None else hub
    policy = Policy(settings.policy)
    layout = layout_of(policy.contract, settings.names)
    plant = plant_of(settings.run, policy.contract, settings.seed, settings.seconds)
    simulator = SimulatorNode(settings, plant, Loopback(hub), layout)
    follower = PolicyNode(settings, policy, Loopback(hub), layout)
    return hub, Task(simulator.run), Task(lambda: follower.run() or follower.counts)


def by_hand(file, steps):
    """Drive MuJoCo by the policy from the pose in which the biped starts, and return ``qpos`` in the end.

    Readings are taken from MuJoCo's own names: nothing of the nodes, nor of the task, is used.
    """
    from gctd3.robots.robot import Robot

    robot = Robot.from_mjcf("biped")
    model, policy = robot.model, Policy(file)
    data = mujoco.MjData(model)
    data.qpos[:] = robot.start_qpos
    mujoco.mj_forward(model, data)
    for step in range(steps):
        readings = {"height_m": data.joint("root_z").qpos[0] + 0.0235, "velocity_m_s": data.joint("root_x").qvel[0]}
        for side in ("right", "left"):
            for joint in (f"hip_{side}", f"knee_{side}", f"ankle_{side}"):
                readings[f"angle_{joint}_rad"] = data.joint(joint).qpos[0]
                readings[f"velocity_{joint}_rad_s"] = data.joint(joint).qvel[0]
            readings[f"down_foot_{side}"] = data.sensor(f"foot_{side}").data[0] > 0
        for name, angle in policy.step(readings, step * PERIOD).items():
            data.actuator(name).ctrl[0] = angle
        mujoco.mj_step(model, data, 4)
    return data.qpos


# In lock-step.


def test_a_walk_over_messages_is_the_walk_by_hand_to_the_bit(exported):
    """From the start pose to the finish, in as many steps; nothing is refused."""
    settings = RosSettings(policy=str(exported))
    hub, simulator, policy = nodes(settings)
    walk = simulator.done()
    assert walk.ended == "finish" and walk.distance >= 15.0 and walk.refused == walk.late == walk.missed == 0
    assert walk.qpos.tolist() == by_hand(exported, walk.steps).tolist()
    counts = policy.done()
    assert (counts.steps, counts.refused) == (walk.steps, 0)
    assert len(hub.of("/joint_states")) == len(hub.of("/joint_command")) == len(hub.of("/clock")) == walk.steps
    alone = run_without_ros(settings)
    assert alone.qpos.tolist() == walk.qpos.tolist() and alone.steps == walk.steps


@pytest.mark.parametrize("names", ["paper", "authors"])
def test_the_papers_topics_carry_the_same_walk(exported, names):
    settings = RosSettings(policy=str(exported), names=names, seconds=1.0)
    hub, simulator, policy = nodes(settings)
    walk = simulator.done()
    np.testing.assert_allclose(walk.qpos, by_hand(exported, 50), atol=1e-6)
    assert policy.done().steps == walk.steps == 50
    # Eight names in alphabetical order, the boom's first; the height counts downwards from where the robot is spawned.
    (first, *_) = hub.of("/Joint_states" if names == "paper" else "/joint_states")
    assert list(first.names) == sorted(first.names) and first.names[:2] == ("boom_waist", "outer_inner")
    assert len(first.names) == 8 and first.positions[0] == pytest.approx(0.0, abs=1e-12)
    assert len(hub.of("/waist_thighR_position_controller/command")) == 50


@pytest.mark.nightly
def test_a_pause_changes_nothing(exported):
    hub, simulator, policy = nodes(RosSettings(policy=str(exported), seconds=1.0, patience=0.5))
    while len(hub.of("/joint_states")) < 10:
        time.sleep(0.001)
    hub.services["/pause"]()
    time.sleep(0.3)
    there = len(hub.of("/joint_states"))
    # Longer than the nodes' patience: the clock, which stands, says that the simulator is there.
    time.sleep(0.7)
    assert len(hub.of("/joint_states")) == there < 50
    hub.services["/unpause"]()
    assert simulator.done().qpos.tolist() == by_hand(exported, 50).tolist()
    assert policy.done().refused == 0


def test_a_reset_begins_anew(exported):
    """The policy forgets its history together with the robot's place: the walk after it is a first one."""
    hub, simulator, policy = nodes(RosSettings(policy=str(exported), seconds=1.0))
    while len(hub.of("/joint_states")) < 10:
        time.sleep(0.001)
    hub.services["/reset"]()
    walk = simulator.done()
    assert walk.steps == 50 and walk.qpos.tolist() == by_hand(exported, 50).tolist()
    assert policy.done().steps > 59
    assert [sample.frame for sample in hub.of("/joint_states")][-1] == "episode 2"


@pytest.mark.nightly
def test_the_time_of_day_is_kept(exported):
    """A second of walking takes a second, and a state goes out in each control period."""
    began = time.monotonic()
    hub, simulator, policy = nodes(RosSettings(policy=str(exported), clock="wall", seconds=1.0, wait=5.0))
    walk = simulator.done()
    assert walk.steps == 50 and time.monotonic() - began >= 1.0
    stamps = np.diff([sample.stamp for sample in hub.of("/joint_states")]) / 1e9
    assert np.median(stamps) == pytest.approx(PERIOD, abs=0.005)
    policy.done()


# Silence and bad messages.


class Peer:
    """Stand at the other end of a node."""

    def __init__(self, exported, side, **settings):
        self.settings = RosSettings(policy=str(exported), patience=0.3, **settings)
        self.hub, self.policy = Hub(), Policy(exported)
        self.contract = self.policy.contract
        self.layout = layout_of(self.contract, self.settings.names)
        self.link = Loopback(self.hub)
        sensors, commands = self.layout.sensors, self.layout.commands
        self.link.advertise([*(sensors if side == "policy" else commands), ENDED, CMD_VEL])
        self.link.subscribe(commands if side == "policy" else sensors)

    def send(self, stamp, frame="episode 1", **changed):
        """Send readings of a robot that stands."""
        values = {**dict.fromkeys(self.contract.readings, 0.0), "down_foot_right": 1.0, "down_foot_left": 1.0}
        for topic, message in self.layout.pack_readings(stamp, frame, {**values, "distance_m": 0.0}):
            joints = topic == self.layout.joints
            self.link.publish(topic, replace(message, **changed) if joints else message)

    def home(self):
        return {servo.joint: servo.home_rad for servo in self.contract.servos}


@pytest.mark.nightly
@pytest.mark.parametrize("clock", ["lockstep", "wall"])
def test_without_readings_the_policy_goes_home_and_ends(exported, clock, capfd):
    peer = Peer(exported, "policy", clock=clock)
    node = Task(PolicyNode(peer.settings, peer.policy, Loopback(peer.hub), peer.layout).run)
    peer.send(time.time_ns())
    with pytest.raises(MiddlewareError, match=r"No good readings for 0\.\d s \(within the process\).*'home'"):
        node.done()
    said = capfd.readouterr().err
    assert "policy: No good readings for 0." in said and "the safe command is in force" in said
    commands = peer.hub.of("/joint_command")
    assert dict(zip(commands[-1].names, commands[-1].positions, strict=True)) == peer.home()
    # Held for the contract's periods, then no faster than its rate.
    ways = np.diff([command.positions for command in commands], axis=0)
    hold = peer.contract.safety.hold_periods
    assert not ways[:hold].any() and ways.any()
    assert np.abs(ways).max() <= max(s.home_rate_rad_s for s in peer.contract.servos) * PERIOD + 1e-12


@pytest.mark.parametrize(
    "changed, said",
    [
        ({"positions": (0.0,) * 5}, "/joint_states has 6 names and 5 positions, expected as many of both."),
        ({"velocities": (0.0,) * 7}, "/joint_states has 6 names and 7 velocities, expected as many of both."),
        ({"names": tuple("abcdef")}, "/joint_states has 6 joints, expected 6; missing hip_"),
        ({"late": 0}, "Stale readings: they are 0.0000 s newer than those before, expected 0.0200 s."),
        ({"positions": (9.0,) * 6}, "angle_hip_right_rad must be between"),
        ({"positions": (float("nan"),) * 6}, "angle_hip_right_rad must be a finite number, got nan."),
    ],
)
def test_a_bad_message_is_refused_and_the_safe_command_sent(exported, changed, said, capfd):
    peer = Peer(exported, "policy")
    follower = PolicyNode(peer.settings, peer.policy, Loopback(peer.hub), peer.layout)
    node = Task(follower.run)
    peer.send(10**9)
    while not (first := peer.hub.of("/joint_command")):
        time.sleep(0.001)
    peer.send(10**9 + changed.pop("late", 20_000_000), **changed)
    while len(peer.hub.of("/joint_command")) < 2:
        time.sleep(0.001)
    peer.link.publish(ENDED, "time")
    node.done()
    told = capfd.readouterr().err
    assert f"policy: Refused: {said}" in told and "The safe command is in force." in told
    assert follower.counts.refused == 1
    # The first safe command holds the last good one.
    assert peer.hub.of("/joint_command")[1].positions == first[0].positions


@pytest.mark.parametrize("clock", ["lockstep", "wall"])
def test_without_commands_the_robot_follows_the_safe_command(exported, clock, capfd):
    from gctd3.bridge.plant import plant_of

    peer = Peer(exported, "simulator", clock=clock)
    plant = plant_of(None, peer.contract, None, None)
    node = SimulatorNode(peer.settings, plant, Loopback(peer.hub), peer.layout)
    with pytest.raises(MiddlewareError, match=r"No good command for 0\.3 s.*phase 'home' of the safe command"):
        node.run()
    assert "simulator: No good command for 0.3 s" in capfd.readouterr().err
    names = [servo.joint for servo in peer.contract.servos]
    assert dict(zip(names, plant._data.ctrl.tolist(), strict=True)) == peer.home()


@pytest.mark.parametrize(
    "message, said",
    [
        (JointSample(10**9, "", ("hip_right",), (0.0,)), "/joint_command has 1 joints, expected 6; missing knee_right"),
        (JointSample(10**9 - 1, "", (), ()), "/joint_command has 0 joints, expected 6"),
        (None, "/joint_command is stale: it answers readings that are 0.020 s older than those it has to answer."),
    ],
)
def test_a_bad_command_is_refused(exported, message, said, capfd):
    from gctd3.bridge.plant import plant_of

    peer = Peer(exported, "simulator")
    node = SimulatorNode(peer.settings, plant_of(None, peer.contract, None, None), Loopback(peer.hub), peer.layout)
    task = Task(node.run)
    while not peer.hub.of("/joint_states"):
        time.sleep(0.001)
    stale = peer.layout.pack_command(10**9 - 20_000_000, "", dict.fromkeys(peer.policy.command, 0.5))[0][1]
    peer.link.publish(Topic("/joint_command", "joints"), message or stale)
    with pytest.raises(MiddlewareError, match="No good command"):
        task.done()
    assert f"simulator: Refused: {said}" in capfd.readouterr().err


def test_the_robot_goes_home_before_it_walks(exported):
    """From where its joints are, no faster than the contract allows, and only then by the policy."""
    peer = Peer(exported, "policy", home_first=True)
    follower = PolicyNode(peer.settings, peer.policy, Loopback(peer.hub), peer.layout)
    node, place = Task(follower.run), 0.1
    for i in range(20):
        positions = tuple(place if row.name.startswith("hip") else 0.0 for row in peer.layout.rows)
        peer.send(10**9 + i * 20_000_000, positions=positions)
    peer.link.publish(ENDED, "time")
    node.done()
    hips = [dict(zip(c.names, c.positions, strict=True))["hip_right"] for c in peer.hub.of("/joint_command")]
    servo = next(servo for servo in peer.contract.servos if servo.joint == "hip_right")
    # At 0.5 rad/s and 50 Hz it is 0.01 rad in each control period.
    way = max(round((place - servo.home_rad) / (servo.home_rate_rad_s * PERIOD)), 1)
    assert hips[:way] == pytest.approx(np.linspace(place, servo.home_rad, way + 1)[1:].tolist(), abs=1e-9)
    # In floating point ten hundredths are not quite a tenth.
    assert follower.counts.steps in (19 - way, 20 - way) and follower.counts.refused == 0


def test_alone_a_node_says_what_it_waits_for(exported):
    peer = Peer(exported, "policy", wait=0.1)
    node = PolicyNode(peer.settings, peer.policy, Loopback(Hub()), peer.layout)
    with pytest.raises(MiddlewareError, match=r"After 0\.1 s nobody is at the other end of /height_m, .*process"):
        node.run()


# Velocities.


@pytest.mark.nightly
def test_cmd_vel_steers(exported_velocity):
    """A velocity reaches the policy as its commands, within their ranges, and counts as 0 when it is not repeated."""
    file = exported_velocity
    policy = Policy(file)
    contract, hub, seen = read_contract(file.with_suffix(".json")), Hub(), []
    layout = layout_of(contract, "contract")
    step = policy.step
    policy.step = lambda readings, when, now, command: seen.append(command) or step(readings, when, now, command)
    peer = Loopback(hub)
    peer.advertise([*layout.sensors, ENDED, CMD_VEL])
    peer.subscribe(layout.commands)
    node = PolicyNode(RosSettings(policy=str(file), command_timeout=0.11), policy, Loopback(hub), layout)
    task = Task(node.run)
    low, high = contract.commands["command_forward_m_s"]
    middle = (low + high) / 2
    values = {f.reading: (f.low + f.high) / 2 for f in contract.features}
    values |= {name: 0.0 for name in values if name.startswith("down_")}
    for i, velocity in enumerate([None, Velocity(middle, 0.0, 0.0), *[None] * 7, Velocity(99.0, 0.0, float("nan"))]):
        if velocity is not None:
            peer.publish(CMD_VEL, velocity)
        stamp = 10**9 + i * 20_000_000
        upright = ImuSample(stamp, "base_link", (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
        for topic, message in layout.pack_readings(stamp, "", {**values, "distance_m": 0.0}, upright):
            peer.publish(topic, message)
    peer.publish(ENDED, "time")
    task.done()
    stands = min(max(0.0, low), high)
    # Six control periods are longer than the timeout.
    assert [one["command_forward_m_s"] for one in seen] == [stands, *[middle] * 5, *[stands] * 3, high]
    assert set(seen[0]) == set(contract.commands) and seen[-1]["command_turn_rad_s"] == 0.0
