"""Policies in other engines beside MuJoCo: states, falls, contacts and walks; sanity and boundaries by hand."""

import json
import math
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from other_engines import engine_of, free_robot, servos_of
from running import command

from gctd3.deploy.policy import Policy
from gctd3.engines.crosscheck import CrossCheck
from gctd3.engines.parting import find_parting
from gctd3.engines.reference import Reference
from gctd3.engines.sanity import Bounds
from gctd3.engines.settings import CrossCheckSettings
from gctd3.engines.walk import Walk, walk
from gctd3.runs.evaluate import measure_run
from gctd3.runs.load import load_run
from gctd3.runs.settings import EvaluateSettings

DT, LEG = 0.02, 0.5


# Of Gazebo's library a program is compiled.
ENGINES = ["dart", "bullet", pytest.param("gazebo", marks=pytest.mark.nightly)]


def made_up(steps=100, speed=1.0, **changed):
    """Make the record of a robot that walks at a constant speed, a foot down at a time."""
    time = DT * np.arange(1, steps + 1)
    feet = np.arange(steps)[:, None] // 10 % 2 == np.arange(2)
    kept = {
        "position": speed * time,
        "height": 0.01 * np.sin(time),
        "angles": np.zeros((steps, 3)),
        "rates": np.ones((steps, 3)),
        "feet_down": feet,
        "lowest": np.full(steps, -0.001),
        "torque": np.ones((steps, 3)),
        "peak": np.ones((steps, 3)),
        "desired": np.zeros((steps, 3)),
        "finished": True,
        "fell": False,
    }
    return Walk(**{**kept, **changed})


# The verdict.


@pytest.mark.parametrize(
    ("mujocos", "others", "said"),
    [
        (1.0, 1.09, None),
        (1.0, 1.2, "+20%"),
        (-1.0, -0.8, "+20%"),
        # A Froude number of 0.01 is 0.22 m/s with legs of 0.5 m: a robot that jumps moves less, and may by 0.022 m/s.
        (0.01, 0.03, None),
        (-0.02, 0.02, "+0.04 m/s"),
        (0.0, 0.3, "+0.30 m/s"),
    ],
)
def test_speeds_are_compared_by_their_ratio_unless_the_robot_stays_where_it_is(mujocos, others, said, monkeypatch):
    # No engine is needed to compare speeds.
    monkeypatch.setattr("gctd3.engines.settings.find_spec", lambda package: package)
    task = SimpleNamespace(control_dt=DT, robot=SimpleNamespace(leg_length=LEG, feet=("right", "left")))
    known, found = (made_up(speed=mujocos),), (made_up(speed=others),)
    check = CrossCheck(CrossCheckSettings(), task, ("a", "b", "c"), known, found, ((),), 0.0, ())
    assert check.reasons() == ([] if said is None else [f"Its speed differs from MuJoCo's by {said}."])


# Sanity.

BOUNDS = Bounds.of([made_up()], LEG, DT)


def test_a_walk_like_the_reference_is_sane_and_bounds_are_those_of_hand_arithmetic():
    assert BOUNDS.broken(made_up()) == []
    # Half a leg of 0.5 m; three times 1 m/s; 30 rad/s; a twentieth of a leg; half a second.
    assert (BOUNDS.height, BOUNDS.rate, BOUNDS.sink, BOUNDS.air) == (0.25, 30.0, 0.025, 0.5)
    assert math.isclose(BOUNDS.speed, 3.0)


@pytest.mark.parametrize(
    ("changed", "phrase"),
    [
        # The finish is reached in flight, 14 m above the ground, at 20 m/s.
        ({"height": np.linspace(0, 14, 100)}, "the body rose to 14 m, more than 0.25"),
        ({"position": 20 * DT * np.arange(1, 101)}, "it moved at 20 m/s, more than 3"),
        ({"rates": np.full((100, 3), -80.0)}, "a joint turned at 80 rad/s, more than 30"),
        ({"lowest": np.full(100, -0.2)}, "a foot sank by 0.2 m, more than 0.025"),
        ({"feet_down": np.arange(100)[:, None] < [40, 40]}, "no foot was down for 1.2 s, more than 0.5"),
        ({"lowest": np.full(100, np.nan)}, "the simulation exploded"),
    ],
)
def test_a_walk_that_no_robot_can_walk_is_named(changed, phrase):
    assert BOUNDS.broken(made_up(**changed)) == [phrase]


# Boundaries.


def test_walks_part_at_the_servos_the_first_contact_or_by_drift():
    landed = {"feet_down": np.arange(100)[:, None] >= [20, 20]}
    reference = made_up(**landed)

    def parts(at, flight=0.0):
        angles = np.zeros((100, 3))
        angles[at:, 1] = 1.0
        parting = find_parting(made_up(angles=angles, **landed), reference, flight, DT)
        return parting.boundary, round(parting.time, 6)

    assert parts(5) == ("servo", 0.12)
    assert parts(25) == ("first contact", 0.52)
    assert parts(80) == ("drift", 1.62)
    # Servos that differ in free flight explain what comes later.
    assert parts(80, flight=0.3)[0] == "servo"
    # A walk that ends early has parted by then.
    short = made_up(steps=50, feet_down=landed["feet_down"][:50])
    assert find_parting(short, reference, 0.0, DT).time == 1.0


# Engines.


@pytest.mark.parametrize("name", ENGINES)
def test_a_free_robot_is_where_it_was_put_and_falls_as_bodies_do(name, contract, tmp_path):
    engine, robot = engine_of(name), free_robot()
    other = engine(robot, servos_of(contract, robot), 0.001, False, tmp_path)
    rng = np.random.default_rng(0)
    qpos, qvel = rng.uniform(-0.5, 0.5, robot.model.nq), rng.uniform(-1, 1, robot.model.nv)
    qpos[3:7] = np.array([0.5, 0.5, 0.1, -0.7])  # of length 1
    other.reset(qpos, qvel, above=5.0)
    place, motion = other.state()
    # Of a quaternion both signs are the same rotation.
    place[3:7] *= np.sign(place[3:7] @ qpos[3:7])
    np.testing.assert_allclose(place - [0, 0, 5, *[0] * (robot.model.nq - 3)], qpos, rtol=0, atol=1e-9)
    np.testing.assert_allclose(motion, qvel, rtol=0, atol=1e-9)
    # The same free flight in MuJoCo: the robot tumbles, its legs swing freely.
    data, model = mujoco.MjData(robot.model), robot.model
    model.opt.timestep = 1e-4
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    data.qpos[:], data.qvel[:] = place, motion
    for _ in range(5):
        other.advance(np.zeros(2))
    for _ in range(round(5 * DT / 1e-4)):
        mujoco.mj_step(model, data)
    after, _ = other.state()
    after[3:7] *= np.sign(after[3:7] @ data.qpos[3:7])
    np.testing.assert_allclose(after, data.qpos, rtol=0, atol=2e-3)
    assert other.touching() == frozenset() and not other.exploded


@pytest.mark.parametrize("name", ENGINES)
def test_the_biped_that_is_dropped_lands_on_its_feet(name, contract, robot, tmp_path):
    other = engine_of(name)(robot, contract, 0.001, True, tmp_path)
    other.reset(robot.start_qpos, np.zeros(robot.model.nv))
    assert other.touching() == frozenset()
    home = np.array([servo.home_rad for servo in contract.servos])
    for _ in range(15):
        other.advance(home)
    assert other.touching() == {"foot_right", "foot_left"}
    # Its weight is carried: the soles are on the ground, the drop is 23.5 mm.
    np.testing.assert_allclose(other.state()[0][1], -0.0235, atol=2e-3)


@pytest.mark.parametrize("name", ENGINES)
def test_without_armature_the_servos_explode_and_the_engine_stands_still(name, contract, robot, tmp_path):
    other = engine_of(name)(robot, contract, 0.001, False, tmp_path)
    other.reset(robot.start_qpos, np.zeros(robot.model.nv))
    high = np.array([servo.high_rad for servo in contract.servos])
    for _ in range(10):
        other.advance(high)
    assert other.exploded


def test_in_mujoco_the_walk_is_that_of_an_evaluation(exported):
    """The policy behind its contract, and readings by name, walk as the network in the batched environment does."""
    run, policy = load_run(None), Policy(exported)
    task = run.task("export")
    rng = np.random.default_rng(10_000)
    walked = walk(task, policy, Reference(task.robot, task.control_dt), task.start(rng), 0)
    assert walked.finished and not walked.refused
    report = measure_run(EvaluateSettings(episodes=1, threads=1)).report
    # Of float32 and float64 the steps differ by chaos, and the walk does not.
    assert walked.speed(task.control_dt) == pytest.approx(report["velocity_mean"], rel=0.01)


# The command.


@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ("timestep=0.003", "timestep must divide the control period of 0.02 s, got 0.003 s"),
        ("engine=ode", "engine must be"),
        ("policy=policy.pt2", "policy must be a .onnx file"),
        ("episodes=0", "episodes must be at least 1"),
    ],
)
def test_wrong_settings_are_refused_before_any_work(argument, message, capfd):
    engine_of("dart")
    assert command("crosscheck", argument) == 2
    assert message in capfd.readouterr().err


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["dart", "bullet", "gazebo"])
def test_the_packaged_policy_walks_in_another_engine(name, exported, tmp_path, capfd):
    engine_of(name)
    out = tmp_path / "check.json"
    assert command("crosscheck", f"policy={exported}", f"engine={name}", "episodes=3", f"out={out}") == 0
    assert "Passed" in capfd.readouterr().out
    report = json.loads(out.read_text())
    one, other = report["mujoco"], report[name]
    assert other["finishes"] == 1.0 and abs(other["speed_m_s"] / one["speed_m_s"] - 1) < 0.1
    assert report["flight_difference_rad"] < 0.05


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["dart", "bullet", "gazebo"])
def test_without_armature_the_check_fails_at_the_servos(name, exported, capfd):
    engine_of(name)
    arguments = (f"policy={exported}", f"engine={name}", "episodes=2", "armature=false")
    assert command("crosscheck", *arguments) == 1
    printed = capfd.readouterr().out
    assert "Failed" in printed and "2 at the servos" in printed
