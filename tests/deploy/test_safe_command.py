"""The safe command, by hand: held for three periods, then home at 0.5 rad/s; what starts and what stops a policy."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_policies import (
    HOLD,
    HOME,
    HOME_RATE,
    MOST_CHANGE,
    RATE,
    TILT,
    following_contract,
    slewing_contract,
    small_contract,
    ticking_contract,
    write_policy,
)

from gctd3.deploy import Policy
from gctd3.deploy.contract import Node
from gctd3.errors import ContractError, ReadingError

pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
P = 1 / RATE  # control period (s)
STEP = HOME_RATE * P  # 0.005 rad a period
STAND = {"asked": 0.0}  # command of the policy that follows


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return write_policy(tmp_path_factory.mktemp("small"))


@pytest.fixture
def policy(file):
    return Policy(file)


def good(policy, **changed):
    return {**dict.fromkeys(policy.contract.readings, 0.0), **changed}


def refused(policy, readings=None, time=None, command=None):
    with pytest.raises(ReadingError) as error:
        policy.step(readings, time, command=command)
    return error.value


class Fixed:
    """Replace the network by one action."""

    def __init__(self, *action):
        self.action, self.seen = np.array([action], dtype=np.float32), []

    def run(self, names, given):
        self.seen.append(given["nodes"])
        return [self.action]


def test_held_then_home_at_the_stated_rate_then_there(policy):
    policy._session = Fixed(0.22, -0.5)
    # From home (0.2, -0.2) no more than 0.3 rad in a step: 0.22 and -0.5 are within.
    assert list(policy.step(good(policy), 0.0).values()) == pytest.approx([0.22, -0.5])
    assert policy.phase == "policy"
    for _ in range(3):
        assert list(refused(policy).command.values()) == pytest.approx([0.22, -0.5])
        assert policy.phase == "hold"
    # 0.02 rad take four periods of 0.005 rad, 0.3 rad take sixty.
    for period in range(1, 60):
        command = refused(policy).command
        assert list(command.values()) == pytest.approx([0.22 - min(period * STEP, 0.02), -0.5 + period * STEP])
        assert policy.phase == "to home"
    assert refused(policy).command == {"servo_hip": 0.2, "servo_knee": -0.2}
    assert policy.phase == "home"
    for _ in range(5):
        assert refused(policy).command == {"servo_hip": 0.2, "servo_knee": -0.2} == policy.command


def test_one_refused_reading_costs_one_period(policy):
    network = policy._session = Fixed(0.0, 0.0)
    policy.step(good(policy, roll_rate=1.0), 0.0)
    refused(policy, good(policy, roll_rate=math.nan), P)
    policy.step(good(policy, roll_rate=3.0), 2 * P)
    # The frame that is missing is the last good one again: the history of two frames holds it and the new one.
    assert network.seen[-1][0, 0].tolist() == [0, 1, 0, 3]
    assert policy.phase == "policy"


def test_missing_frames_are_the_last_one_again(tmp_path):
    policy = Policy(write_policy(tmp_path, small_contract(frames=4)))
    network = policy._session = Fixed(0.0, 0.0)
    for i in range(3):
        policy.step(good(policy, roll_rate=i + 1.0), i * P)
    refused(policy, None, 3 * P)
    policy.step(good(policy, roll_rate=5.0), 4 * P)
    # Two late periods: the times say so, whatever was called.
    policy.step(good(policy, roll_rate=8.0), 7 * P)
    assert [seen[0, 0, 1::2].tolist() for seen in network.seen] == [
        [1, 1, 1, 1],
        [1, 1, 1, 2],
        [1, 1, 2, 3],
        [2, 3, 3, 5],
        [5, 5, 5, 8],
    ]


def test_the_period_of_a_refused_reading_may_be_tried_again(policy):
    policy.step(good(policy), 0.0)
    refused(policy, None, P)
    policy.step(good(policy), P)
    assert "Stale" in str(refused(policy, good(policy), P))


def test_after_more_missed_periods_than_are_held_the_history_begins_anew(policy):
    network = policy._session = Fixed(0.0, 0.0)
    policy.step(good(policy, roll_rate=1.0), 0.0)
    for i in range(1, HOLD + 2):
        refused(policy, None, i * P)
    policy.step(good(policy, roll_rate=3.0), (HOLD + 2) * P)
    assert network.seen[-1][0, 0].tolist() == [0, 3, 0, 3]


def test_a_late_reading_is_used_if_no_more_periods_are_missed_than_are_held(policy):
    network = policy._session = Fixed(0.0, 0.0)
    policy.step(good(policy, roll_rate=1.0), 0.0)
    policy.step(good(policy, roll_rate=2.0), (HOLD + 1) * P)
    assert network.seen[-1][0, 0].tolist() == [0, 1, 0, 2]
    assert "Steps were missed: the readings are 0.0500 s newer" in str(refused(policy, good(policy), 9 * P))


def test_times_in_milliseconds_are_refused_every_time(policy):
    policy.step(good(policy), 0.0)
    for i in range(1, 10):
        assert "missed" in str(refused(policy, good(policy), i * 1e3 * P))


def test_a_clock_that_was_set_back_needs_a_reset(policy):
    policy._session = Fixed(0.4, -0.4)
    command = policy.step(good(policy), 3600.0)
    for i in range(3):
        assert "The clock went back by 3600.0000 s. If it was set back, call reset()" in str(
            refused(policy, good(policy), i * 1e-9)
        )
    policy.reset()
    # The command does not jump.
    assert policy.command == command
    assert policy.step(good(policy), P) == command


def test_a_wrong_time_does_not_set_the_clock_forward(policy):
    policy.step(good(policy), 0.0)
    refused(policy, good(policy), 1e6)
    policy.step(good(policy), 2 * P)
    # It is forgotten by then, too: the same one again does not agree with it.
    refused(policy, good(policy), 1e6 + P)
    policy.step(good(policy), 4 * P)


def test_a_tilt_stops_until_reset(policy):
    policy._session = Fixed(0.0, 0.0)
    # arccos(cos 0.6 cos 0.6) = 0.8210 is above 0.8, arccos(cos 0.6 cos 0.5) = 0.7607 is not.
    policy.step(good(policy, roll_rad=0.6, pitch_rad=0.5), 0.0)
    error = refused(policy, good(policy, roll_rad=-0.6, pitch_rad=0.6), P)
    assert "Stopped: the body was tilted by 0.821 rad, allowed are 0.800 rad. Call reset()" in str(error)
    # Up again: still stopped, and on the way home after three periods.
    for i in range(2, 5):
        assert "Stopped: the body was tilted" in str(refused(policy, good(policy), i * P))
    assert policy.phase == "to home" and policy.stopped
    with pytest.raises(ReadingError, match="Stopped"):
        policy.start(good(policy))
    policy.reset()
    assert policy.stopped is None
    policy.step(good(policy), 5 * P)
    assert math.acos(math.cos(0.6) * math.cos(0.5)) < TILT < math.acos(math.cos(0.6) ** 2)


def test_start_takes_the_joints_home_from_where_they_are(policy):
    at = good(policy, angle_hip_rad=0.5, angle_knee_rad=-0.21)
    # 0.3 rad take sixty periods; 0.01 rad take two.
    for period in range(1, 60):
        command = policy.start(at)
        assert list(command.values()) == pytest.approx([0.5 - period * STEP, -0.21 + min(period * STEP, 0.01)])
        assert not policy.at_home
    assert policy.start(at) == {"servo_hip": 0.2, "servo_knee": -0.2} and policy.at_home
    # A walk begins with any time.
    policy.step(good(policy), -5.0)
    assert not policy.at_home


def test_a_robot_is_at_home_only_after_a_start_that_arrived(policy):
    assert not policy.at_home
    at = good(policy, angle_hip_rad=0.2, angle_knee_rad=-0.2)
    policy.start(at)
    assert policy.at_home
    with pytest.raises(ReadingError):
        policy.start(None)
    assert not policy.at_home
    policy.start(at)
    policy.reset()
    assert not policy.at_home


def test_start_survives_a_refused_reading(policy):
    at = good(policy, angle_hip_rad=0.5)
    first = policy.start(at)["servo_hip"]
    with pytest.raises(ReadingError) as error:
        policy.start(good(policy, angle_hip_rad=math.inf))
    assert error.value.command["servo_hip"] == first == 0.5 - STEP
    assert policy.start(at)["servo_hip"] == pytest.approx(first - STEP)


def test_a_joint_beyond_the_servos_limit_starts_at_the_limit(policy):
    assert policy.start(good(policy, angle_hip_rad=1.2))["servo_hip"] == pytest.approx(1.0 - STEP)


def test_a_policy_that_does_not_read_its_joints_cannot_be_started(tmp_path):
    contract = small_contract()
    servos = tuple(dataclasses.replace(servo, angle_reading=None) for servo in contract.servos)
    policy = Policy(write_policy(tmp_path, small_contract(servos=servos)))
    with pytest.raises(ContractError, match="does not read the angle of every joint"):
        policy.start(good(policy))


def test_the_policy_knows_its_last_action_itself(tmp_path):
    policy = Policy(write_policy(tmp_path, following_contract(frames=2)))
    assert policy.contract.readings == ("gravity_up", "pitch_rad", "angle_knee_rad", "angle_hip_rad", "down")
    network = policy._session = Fixed(0.25, -0.5)
    upright = good(policy, gravity_up=-1.0)
    policy.step(upright, 0.0, command=STAND)
    refused(policy, None, P)
    policy.step(upright, 2 * P, command=STAND)
    # Frames of two features; the nodes' order is knee, hip, the action's hip, knee.
    assert network.seen[0][0, 2:4].tolist() == [[0, 0, 0, 0]] * 2
    assert network.seen[1][0, 2:4].tolist() == [[0, 0, 0, -0.5], [0, 0, 0, 0.25]]
    policy.reset()
    policy.step(upright, 0.0, command=STAND)
    assert network.seen[2][0, 2:4].tolist() == [[0, 0, 0, 0]] * 2


def test_the_policy_tells_the_time_of_its_gait_itself(tmp_path):
    """At 2.5 Hz and 100 steps a second a stride is 40 steps: cosines by hand; a late reading is as much later."""
    policy = Policy(write_policy(tmp_path, ticking_contract()))
    assert "clock_cos_foot" not in policy.contract.readings
    network = policy._session = Fixed(0.0, 0.0)
    for time in (7.0, 7.0 + P, 7.0 + 2 * P, 7.0 + 5 * P):
        policy.step(good(policy), time)
    refused(policy, None, 7.0 + 6 * P)
    policy.step(good(policy), 7.0 + 10 * P)
    seen = [nodes[0, 4, 3] for nodes in network.seen]
    np.testing.assert_allclose(seen, np.cos(2 * np.pi * np.array([0, 1, 2, 5, 10]) / 40), atol=1e-6)
    policy.reset()
    policy.step(good(policy), 99.0)
    assert network.seen[-1][0, 4, 3] == pytest.approx(1.0)


@pytest.mark.parametrize("change", [{"clock_hz": 0.0}, {"clock_hz": -1.0}, {"source": "command"}, {"clock_phase": 9.0}])
def test_a_clock_that_is_none_is_refused(change):
    contract = ticking_contract()
    clock = dataclasses.replace(contract.nodes[-1].features[1], **change)
    ground = Node("ground", (contract.nodes[-1].features[0], clock))
    with pytest.raises(ContractError, match="a feature of node 'ground' is a clock without a frequency, or has one"):
        small_contract(nodes=(*contract.nodes[:-1], ground))


def test_a_tilt_is_seen_by_gravitys_direction(tmp_path):
    policy = Policy(write_policy(tmp_path, following_contract()))
    policy.step(good(policy, gravity_up=-math.cos(0.79)), 0.0, command=STAND)
    assert "tilted by 0.810 rad" in str(refused(policy, good(policy, gravity_up=-math.cos(0.81)), P, STAND))


def test_a_command_is_given_apart_from_the_readings(tmp_path):
    policy = Policy(write_policy(tmp_path, following_contract(frames=1)))
    assert policy.contract.commands == {"asked": (-2.0, 2.0)}
    network, upright = Fixed(0.0, 0.0), good(policy, gravity_up=-1.0)
    policy._session = network
    for time, asked in enumerate((1.5, -2)):
        policy.step(upright, time * P, command={"asked": asked})
        assert network.seen[-1][0, 0].tolist() == [-1.0, asked]
    # To the home pose the robot goes without a command.
    policy.start(upright)
    assert len(network.seen) == 2


def test_a_command_with_a_slew_rate_is_approached(tmp_path):
    """Follow by 0.4 a control period, from 0 on, whatever was refused between; anew after more than the missed ones."""
    policy = Policy(write_policy(tmp_path, slewing_contract(frames=1)))
    network, upright = Fixed(0.0, 0.0), good(policy, gravity_up=-1.0)
    policy._session = network

    def told(period, asked):
        policy.step(upright, period * P, command={"asked": asked})
        return float(network.seen[-1][0, 0, 1])

    given = [told(i, asked) for i, asked in enumerate((1.0, 1.0, 1.0, -2.0, -2.0))]
    np.testing.assert_allclose(given, [0.4, 0.8, 1.0, 0.6, 0.2], atol=1e-6)
    refused(policy, upright, 5 * P, {"asked": 2.5})
    # A missed period is one in which the command did not change.
    np.testing.assert_allclose([told(6, 2.0), told(7, 2.0)], [0.6, 1.0], atol=1e-6)
    refused(policy, upright, (9 + HOLD) * P, {"asked": 2.0})
    np.testing.assert_allclose(told(10 + HOLD, 2.0), 0.4, atol=1e-6)
    policy.reset()
    np.testing.assert_allclose(told(0, -0.1), -0.1, atol=1e-6)


@pytest.mark.parametrize("change", [{"slew_rate": -1.0}, {"slew_rate": 1.0, "source": "joint encoder"}])
def test_a_slew_rate_of_no_command_is_refused(change):
    contract = following_contract()
    asked = dataclasses.replace(contract.nodes[0].features[1], **change)
    body = Node("body", (contract.nodes[0].features[0], asked))
    with pytest.raises(ContractError, match="a feature of node 'body' has a slew rate below 0, or has one and is no"):
        dataclasses.replace(contract, nodes=(body, *contract.nodes[1:]))


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (None, "The commands do not fit the contract: missing asked; unknown none."),
        ({}, "The commands do not fit the contract: missing asked; unknown none."),
        ({"asked": 0.0, "speed": 1.0}, "The commands do not fit the contract: missing none; unknown speed."),
        ([0.5], r"The commands must be a mapping from names to numbers, got [0.5]."),
        ({"asked": 2.01}, "asked must be between -2 and 2, got 2.01."),
        ({"asked": math.nan}, "asked must be a finite number, got nan."),
    ],
)
def test_a_command_that_is_none_or_out_of_range_is_refused(tmp_path, command, reason):
    policy = Policy(write_policy(tmp_path, following_contract()))
    before = policy.command
    error = refused(policy, good(policy, gravity_up=-1.0), 0.0, command)
    assert str(error) == reason and error.command == before
    policy.step(good(policy, gravity_up=-1.0), P, command=STAND)


def test_a_policy_without_commands_takes_none_and_no_command_is_a_reading(policy, tmp_path):
    assert policy.contract.commands == {}
    assert str(refused(policy, good(policy), 0.0, STAND)).endswith("missing none; unknown asked.")
    following = Policy(write_policy(tmp_path, following_contract()))
    assert "unknown asked." in str(refused(following, good(following, asked=0.0), 0.0, STAND))


def test_a_last_action_without_a_servo_is_refused():
    contract = following_contract()
    with pytest.raises(ContractError, match="node 'knee' has a last action, and no servo drives it"):
        small_contract(nodes=contract.nodes, servos=contract.servos[:1])


# Properties over arbitrary sequences.

NUMBERS = st.one_of(
    st.floats(-1, 1), st.floats(), st.sampled_from([None, "0", [0.0], 1e30, -1e30, 10**400, np.zeros(2), True, 1j])
)
CALLS = st.lists(
    st.one_of(
        # A good reading, by its roll and its time in periods since the last.
        st.tuples(st.just("good"), st.floats(-0.5, 0.5), st.floats(0.6, 1.4)),
        st.tuples(st.just("bad"), st.sampled_from(["roll_rad", "angle_hip_rad", "down"]), NUMBERS),
        st.tuples(st.just("time"), NUMBERS, st.just(None)),
        st.tuples(st.just("none"), st.sampled_from([None, 3, "x", {}, {"roll_rad": 0.0}, {1: 2}]), st.just(None)),
        st.tuples(st.just("start"), st.floats(-1.4, 1.4), st.just(None)),
        st.tuples(st.just("reset"), st.just(None), st.just(None)),
    ),
    max_size=60,
)


@settings(max_examples=60)
@given(CALLS)
def test_commands_are_finite_within_limits_and_slow_when_safe(policy_of, calls):
    policy, time = policy_of, 0.0
    policy.reset(at_home=True)
    safe = 0
    for kind, one, two in calls:
        before, known = np.array(list(policy.command.values())), policy.command
        time += two * P if kind == "good" else P
        try:
            if kind == "good":
                policy.step(good(policy, roll_rad=one, angle_hip_rad=one), time)
            elif kind == "bad":
                policy.step(good(policy, **{one: two}), time)
            elif kind == "time":
                policy.step(good(policy), one)
            elif kind == "none":
                policy.step(one, time)
            elif kind == "start":
                policy.start(good(policy, angle_hip_rad=one))
            else:
                policy.reset()
            safe = 0 if kind != "reset" else safe
        except ReadingError as error:
            safe += 1
            now = np.array(list(error.command.values()))
            assert error.command == policy.command
            # Held at first; then by no more than the rate, and never away from home.
            assert (np.abs(now - before) <= (0.0 if safe <= HOLD else STEP * (1 + 1e-9))).all()
            assert (np.abs(now - HOME) <= np.abs(before - HOME)).all()
        now = np.array(list(policy.command.values()))
        assert np.isfinite(now).all() and (np.abs(now) <= 1.0).all()
        if kind not in ("start", "reset"):
            assert (np.abs(now - before) <= MOST_CHANGE * (1 + 1e-9)).all()
        if kind == "reset":
            assert policy.command == known


@pytest.fixture(scope="module")
def policy_of(file):
    return Policy(file)


@settings(max_examples=40)
@given(st.integers(0, 50), st.floats(-1, 1), st.floats(-1, 1))
def test_home_is_reached_in_the_time_that_the_rate_gives(policy_of, more, hip, knee):
    policy_of.reset(at_home=True)
    policy_of._safe.accept(np.array([hip, knee]))
    periods = HOLD + math.ceil(max(abs(hip - HOME[0]), abs(knee - HOME[1])) / STEP - 1e-9)
    for _ in range(periods + more):
        refused(policy_of)
    assert list(policy_of.command.values()) == list(HOME)
