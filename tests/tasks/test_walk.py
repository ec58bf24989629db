"""The walking task on hand-made measurements; every expected number follows from the arithmetic beside it."""

from dataclasses import replace

import numpy as np
import pytest
from compositions import reward, walking
from gaits import LEFT, RIGHT, sense, values, walk

from gctd3.errors import ConfigError
from gctd3.robots.robot import Robot
from gctd3.tasks import reward_terms as terms
from gctd3.tasks.terminations import Finish, LongContact, StuckHip, TimeLimit


def alternating(steps, **constant):
    """Make measurements in which feet and hips change sides at every step, so that no counter grows beyond 1."""
    for t in range(steps):
        side = 1.0 if t % 2 else -1.0
        varying = {"hips": (0.1 * side, -0.1 * side), "feet": (t % 2 == 0, t % 2 == 1)}
        yield sense(**{**varying, **{k: f(t) if callable(f) else f for k, f in constant.items()}})


def test_reward_of_three_steps(task):
    drop = sense(z=0.0235, feet=(False, False))
    one = sense(y=0.01, z=-0.005, v=0.5, feet=(True, False))
    two = sense(y=0.04, z=-0.030, v=1.5, feet=(True, True))
    air = sense(y=0.03, z=0.020, v=-0.3, feet=(False, False))
    _, (first, second, third) = walk(task, drop, one, two, air)

    # Five stacked frames: drop x 4, one. One foot down: |-0.005 + 0.010| = 0.005.
    assert " ".join(first.terms) == "velocity progress height flight living fall long_contact stuck_hip"
    assert values(first) == pytest.approx([0.5, 0.2 * 0.01, -0.005 * 0.005, -0.01 * 4, -0.1, 0.0, 0.0, 0.0])
    assert first.reward == pytest.approx(0.5 + 0.002 - 0.000025 - 0.04 - 0.1)
    # drop x 3, one, two. Both feet down: |-0.030 + 0.025| = 0.005 more. 1.5 m/s counts as 0.9 m/s.
    assert second.reward == pytest.approx(0.9 + 0.2 * 0.04 - 0.005 * 0.010 - 0.03 - 0.1)
    # drop x 2, one, two, air: in flight no height is asked for.
    assert third.reward == pytest.approx(-0.3 + 0.2 * 0.03 - 0.005 * 0.010 - 0.03 - 0.1)


def test_progress_looks_back_five_steps_and_no_further_than_the_start(task):
    _, outcomes = walk(task, *alternating(9, y=lambda t: 0.02 * t))
    # 0.2 * (0.02 t - 0) up to t = 5; then 0.2 * 5 * 0.02.
    expected = [0.004, 0.008, 0.012, 0.016, 0.020, 0.020, 0.020, 0.020]
    assert [o.terms["progress"] for o in outcomes] == pytest.approx(expected)


def test_windows_are_settings(robot):
    task = walking(robot, reward(progress=terms.Progress(steps=2), height=terms.BodyHeight(frames=1)))
    _, outcomes = walk(task, *alternating(4, y=lambda t: 0.1 * t, z=0.04))
    assert [o.terms["progress"] for o in outcomes] == pytest.approx([0.02, 0.04, 0.04])
    # One frame: |0.04 + 0.010| = 0.05.
    assert [o.terms["height"] for o in outcomes] == pytest.approx([-0.005 * 0.05] * 3)


@pytest.mark.parametrize(
    ("now", "falls"),
    # The last one is penalised once, not twice.
    [(sense(z=-0.1), 0), (sense(z=-0.1001), 1), (sense(other=True), 1), (sense(z=-0.2, other=True), 1)],
)
def test_fall(task, now, falls):
    _, (outcome,) = walk(task, sense(), now)
    assert outcome.terms["fall"] == -10.0 * falls
    assert outcome.terminated == falls
    assert not outcome.truncated


@pytest.mark.parametrize("foot", [RIGHT, LEFT])
def test_a_foot_may_stay_down_for_40_steps(task, foot):
    _, outcomes = walk(task, *alternating(42, feet=(foot == RIGHT, foot == LEFT)))
    assert not any(o.terminated for o in outcomes[:40])
    assert outcomes[40].terminated
    assert values(outcomes[40])[-3:] == [0.0, -1.0, 0.0]  # fall, long contact, stuck hip


def test_a_lifted_foot_counts_anew(task):
    _, outcomes = walk(task, *alternating(82, feet=lambda t: (t != 41, False)))
    assert not any(o.terminated for o in outcomes)


@pytest.mark.parametrize("hip", [RIGHT, LEFT])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_hip_may_keep_its_sign_for_50_steps(task, hip, side):
    def hips(t):
        swinging = 0.1 if t % 2 else -0.1
        return tuple(side * (0.01 + 0.001 * t) if h == hip else swinging for h in (RIGHT, LEFT))

    _, outcomes = walk(task, *alternating(52, hips=hips))
    assert not any(o.terminated for o in outcomes[:50])
    assert outcomes[50].terminated
    assert values(outcomes[50])[-3:] == [0.0, 0.0, -0.5]  # fall, long contact, stuck hip


def test_the_step_that_changes_a_hips_sign_is_its_first(task):
    # The reset's frame and 50 steps in front, then behind from step 51 on: 50 of those are allowed, the 51st ends.
    _, outcomes = walk(task, *alternating(102, hips=lambda t: (0.1, -0.1) if t <= 50 else (-0.1, 0.1)))
    assert [t for t, o in enumerate(outcomes, start=1) if o.terminated] == [101]


def test_endings_that_are_switched_off(robot):
    task = walking(robot, contact_steps=None, hip_steps=None)
    memory, outcomes = walk(task, *[sense(feet=(True, True))] * 101)
    assert not any(o.terminated for o in outcomes)
    # Counted all the same, over the time limit of 1,600.
    assert task.counters(memory) == pytest.approx(np.array([100, 100, 100, -100]) / 1600)


@pytest.mark.parametrize(
    ("taken", "now", "terminated", "truncated", "success"),
    [
        (0, sense(y=14.999), False, False, False),
        (0, sense(y=15.0), False, True, True),
        (1598, sense(), False, False, False),
        (1599, sense(), False, True, False),
        (1599, sense(y=15.0), False, True, True),
        # A truncated value is bootstrapped; a robot that falls over the line must not be.
        (0, sense(y=15.0, z=-0.11), True, False, False),
        (1599, sense(z=-0.11), True, False, False),
    ],
)
def test_finish_and_time_limit_truncate_unless_the_robot_falls(task, taken, now, terminated, truncated, success):
    before = {**task.begin(sense()), "step": np.array(taken)}
    _, outcome = task.advance(before, now)
    assert (outcome.terminated, outcome.truncated, outcome.success) == (terminated, truncated, success)


def test_shaping_of_one_step(robot):
    task = walking(robot, reward(antiphase=0.3, single_support=0.2, overspeed=0.5))
    fast, slow = sense(v=1.7, hips=(0.2, -0.5)), sense(v=1.1, hips=(0.4, -0.4), feet=(True, True))
    _, outcomes = walk(task, sense(), fast, slow, sense(feet=(False, False)))
    # -0.3 * |0.2 - 0.5|, one foot down, -0.5 * (1.7 - 1.2).
    shaping = [[float(o.terms[name]) for o in outcomes] for name in ("antiphase", "single_support", "overspeed")]
    np.testing.assert_allclose(shaping, [[-0.09, 0, 0], [0.2, 0, 0], [-0.25, 0, 0]], atol=1e-12)


@pytest.mark.parametrize(
    ("steps_in_air", "landing", "cost"),
    [
        (10, (True, False), 2.0 * (0.25 - 0.20)),
        (5, (True, False), 2.0 * (0.25 - 0.10)),
        (15, (True, False), 0.0),
        (30, (True, False), 2.0 * (0.60 - 0.35)),
        (10, (True, True), 2 * 2.0 * (0.25 - 0.20)),
    ],
)
def test_a_time_in_the_air_out_of_bounds_costs_at_touchdown(robot, steps_in_air, landing, cost):
    task = walking(robot, reward(swing=terms.SwingTime(-2.0, least=0.25, most=0.35)))
    down, up = sense(feet=(True, True)), sense(feet=(False, False))
    _, outcomes = walk(task, down, *[up] * steps_in_air, sense(feet=landing), sense(feet=landing))
    paid = [float(o.terms["swing"]) for o in outcomes]
    assert paid == pytest.approx([0.0] * steps_in_air + [-cost, 0.0])


def test_short_flights_can_be_free(robot):
    task = walking(robot, reward(flight=terms.Flight(-2.0, free=2)))
    up, down = sense(feet=(False, False)), sense(feet=(True, False))
    _, outcomes = walk(task, down, up, up, up, up, down)
    # One to four of the last five frames in flight, then still four.
    assert [float(o.terms["flight"]) for o in outcomes] == pytest.approx([0.0, 0.0, -2.0, -4.0, -4.0])


def test_measure_reads_the_simulator(task):
    # qpos: x, z (standing is -0.0235), six joints. Sensors: both feet, then body, thighs and shanks.
    qpos = np.array([1.5, -0.0335, 0.1, -0.2, 0.3, -0.4, -0.5, 0.6])
    now = task.measure(qpos, 10.0 * qpos, np.array([0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert (now.position, now.height, now.velocity) == pytest.approx((1.5, -0.01, 15.0))
    np.testing.assert_array_equal([now.angles, now.velocities], [qpos[2:], 10.0 * qpos[2:]])
    assert (now.feet_down.tolist(), bool(now.other_down)) == ([False, True], False)
    # Row i feels its sensor i only.
    rows = task.measure(np.tile(qpos, (7, 1)), np.tile(qpos, (7, 1)), np.eye(7))
    assert rows.other_down.tolist() == [False] * 2 + [True] * 5


def test_node_features_of_the_biped(task):
    angles = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    now = replace(sense(y=3.0, z=-0.01, v=0.9), angles=angles, velocities=10.0 * angles)
    features = task.node_features(now)
    # Body; hips, knees and ankles, right before left; ground with its right and its left foot.
    expected = [[-0.01, 0.9], [1, 10], [4, 40], [2, 20], [5, 50], [3, 30], [6, 60], [1, 0]]
    assert features.dtype == np.float32
    np.testing.assert_array_equal(features, np.array(expected, dtype=np.float32))


def test_counters(task):
    start = sense(feet=(False, False))
    assert task.counters(task.begin(start)).tolist() == [0.0] * task.num_counters
    memory, _ = walk(task, start, *[sense()] * 10)
    # Right foot 10 of 40 steps down, left foot 10 up; right hip 10 of 50 steps in front, left hip behind.
    assert task.counters(memory) == pytest.approx(np.array([0.25, -0.25, 0.2, -0.2]))
    memory, _ = task.advance(memory, sense(hips=(-0.1, 0.1), feet=(False, True)))
    assert task.counters(memory) == pytest.approx(np.array([-1 / 40, 1 / 40, -1 / 50, 1 / 50]))


@pytest.mark.parametrize(
    ("term", "name"),
    [
        (terms.Progress, "steps"),
        (terms.BodyHeight, "frames"),
        (terms.Flight, "frames"),
        (LongContact, "steps"),
        (StuckHip, "steps"),
        (TimeLimit, "steps"),
        (Finish, "distance"),
    ],
)
def test_bad_settings_are_named(term, name):
    with pytest.raises(ConfigError, match=rf"^{name} must be .*, got 0\."):
        term(**{name: 0})


def test_a_robot_may_stand_on_one_foot():
    task = walking(Robot.from_mjcf("biped", feet=["foot_right"]))
    now = sense(feet=(True,))
    # The ground has room for two contacts, and the other foot counts as a part that must not touch.
    np.testing.assert_array_equal(task.node_features(now)[-1], (1.0, 0.0))
    assert task.num_counters == 2 and "foot_left" in task.robot.other_contact_bodies
