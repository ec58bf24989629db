"""The task of jumping to a commanded height: soles, memory, pay, ends, command, clock, and both backends."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest
import torch

from gctd3.deploy.robot_contract import sensed
from gctd3.envs.dmc import load
from gctd3.envs.simulation import Simulation
from gctd3.errors import ConfigError
from gctd3.evaluation.recorder import soles
from gctd3.robots.settings import RobotSettings
from gctd3.robots.sole_heights import SoleHeights
from gctd3.tasks.commands import UniformCommand
from gctd3.tasks.jump import JumpSettings, jump_terms
from gctd3.tasks.jump_command import HEIGHT, JumpCommand
from gctd3.tasks.jump_features import JumpClock, jump_features
from gctd3.tasks.jump_memory import APEX, GROUNDED, STOOD, clearance, jumped, sole_heights, standing
from gctd3.tasks.jump_terms import JumpedAndStood, JumpHeight, LeaveSpot, StandAfterJump
from gctd3.tasks.measurement import Measurement
from gctd3.tasks.reward import Reward
from gctd3.tasks.terminations import STEPS
from gctd3.tasks.terms import Step


def task_of(robot="biped", **settings):
    return JumpSettings(**settings).build(RobotSettings(robot))


@pytest.fixture(scope="module")
def biped():
    return task_of(commands={"jump": JumpCommand(levels=[0.1])})


@pytest.fixture(scope="module")
def quadruped():
    return task_of("quadruped")


def sensed_at(z=0.0, feet=(True, True), speed=0.0, other=False, shank=False, tilt=0.0, y=0.0):
    """Make the measurement of a biped with straight legs, whose soles are as high as its body is from standing."""
    return Measurement(
        position=np.array(y),
        height=np.array(z),
        velocity=np.array(0.0),
        angles=np.zeros(6),
        velocities=np.full(6, speed),
        feet_down=np.array(feet),
        other_down=np.array(other),
        shank_down=np.array(shank),
        base=np.zeros((0, 2)),
        tilt=np.array(tilt),
        feet_velocity=np.zeros((0, 3)),
    )


# Soles.


@pytest.mark.parametrize("robot", ["biped", "quadruped", "hexapod"])
def test_soles_are_where_the_simulator_has_them(robot):
    """Compare those of random poses and orientations with MuJoCo's kinematics, and the same on PyTorch."""
    task, rng, count = task_of(robot), np.random.default_rng(0), 30
    own = task.robot
    qpos = np.tile(own.standing_qpos, (count, 1))
    for joint, (low, high) in zip(own.joints, task.facts.ranges, strict=True):
        qpos[:, joint.qpos] = rng.uniform(low, high, count)
    qpos[:, own.base.height.qpos] += rng.uniform(0.0, 0.5, count)
    if own.base.free is not None:
        turn = slice(own.base.free.qpos + 3, own.base.free.qpos + 7)
        qpos[:, turn] += 0.4 * rng.normal(size=(count, 4))
        qpos[:, turn] /= np.linalg.norm(qpos[:, turn], axis=1, keepdims=True)
    now = task.measure(qpos, np.zeros((count, own.model.nv)), np.zeros((count, own.model.nsensordata)))
    expected, _ = soles(own, qpos, task.control_dt)
    np.testing.assert_allclose(sole_heights(now, task.facts), expected, atol=1e-12)
    tensors = Measurement(**{f.name: torch.tensor(getattr(now, f.name)) for f in fields(now)})
    np.testing.assert_allclose(sole_heights(tensors, task.facts).numpy(), expected, atol=1e-6)


def test_a_leg_with_a_joint_that_is_not_measured_has_no_sole(biped):
    cut = replace(biped.robot, joints=biped.robot.joints[1:])
    assert SoleHeights.of(cut) is None and SoleHeights.of(biped.robot) is not None
    with pytest.raises(ConfigError, match="cannot be asked to jump"):
        JumpCommand().fitted(replace(biped.facts, soles=None))


def test_a_foot_is_clear_only_while_nothing_touches_the_ground(biped):
    facts = biped.facts
    assert clearance(sensed_at(0.07, (False, False)), facts) == pytest.approx(0.07)
    for touching in ({"feet": (True, False)}, {"feet": (False, False), "other": True}):
        assert clearance(sensed_at(0.07, **touching), facts) == 0.0
    assert clearance(sensed_at(0.07, (False, False), shank=True), facts) == 0.0
    assert clearance(sensed_at(-0.02, (False, False)), facts) == 0.0


def test_what_counts_as_standing(biped):
    facts = biped.facts
    low = 0.15 * facts.leg_length
    for now, stands in (
        (sensed_at(), True),
        (sensed_at(-low + 0.001), True),
        (sensed_at(-low - 0.001), False),
        (sensed_at(tilt=0.31), False),
        (sensed_at(feet=(True, False)), False),
        (sensed_at(other=True), False),
    ):
        assert bool(standing(now, facts)) is stands


# Memory, pay and ends.

# A drop, the ground, a flight of 0.06 and 0.12 m, and standing.
EPISODE = (
    sensed_at(0.02, (False, False)),
    sensed_at(0.015, (False, False)),
    sensed_at(),
    sensed_at(0.06, (False, False), speed=1.0),
    sensed_at(0.12, (False, False), speed=1.0),
    sensed_at(0.05, (False, False)),
    sensed_at(feet=(True, False)),
    sensed_at(speed=2.0),
    sensed_at(),
    sensed_at(),
)


def played(task, measurements=EPISODE):
    """Return the memory, the terms by name and the outcome of each step."""
    memory, rows = task.begin(measurements[0], np.random.default_rng(0)), []
    for now in measurements[1:]:
        memory, outcome = task.advance(memory, now, rng=np.random.default_rng(0))
        rows.append((memory, {name: float(value) for name, value in outcome.terms.items()}, outcome))
    return rows


def test_memory_of_a_jump(biped):
    rows = played(biped)
    assert [bool(memory[GROUNDED.name]) for memory, *_ in rows] == [False] + 8 * [True]
    # What the robot is dropped from is no jump.
    np.testing.assert_allclose([memory[APEX.name] for memory, *_ in rows], [0, 0, 0.06, *6 * [0.12]])
    # One foot on the ground is not standing.
    assert [int(memory[STOOD.name]) for memory, *_ in rows] == [0, 0, 0, 0, 0, 0, 1, 2, 3]
    np.testing.assert_allclose(jumped(rows[-1][0]), [0.1, 0.12])
    assert jumped({}) is None


def test_standing_begins_anew_when_a_foot_lifts(biped):
    rows = played(biped, (*EPISODE, sensed_at(feet=(False, True)), sensed_at()))
    assert [int(memory[STOOD.name]) for memory, *_ in rows][-3:] == [3, 0, 1]


def test_a_jump_that_is_too_low_is_not_followed_by_standing():
    high = task_of(commands={"jump": JumpCommand(levels=[0.13])})
    assert [int(memory[STOOD.name]) for memory, *_ in played(high)] == 9 * [0]


def test_pay_of_a_jump():
    """Height, by hand: aim = 0.1 + 0.015; |0.115 - 0| - |0.115 - 0.06| = 0.06, then 0.055 - 0.005 = 0.05."""
    terms = {"jump": JumpHeight(weight=2.0, margin=0.015), "stand": StandAfterJump(weight=0.5, speed=2.0)}
    task = JumpSettings(commands={"jump": JumpCommand(levels=[0.1])}).build(RobotSettings("biped"), Reward(terms))
    pays = [pay for _, pay, _ in played(task)]
    np.testing.assert_allclose([pay["jump"] for pay in pays], [0, 0, 2 * 0.6, 2 * 0.5, 0, 0, 0, 0, 0], atol=1e-12)
    # All joints at 2 rad/s: 0.5 / e; before the jump and on one foot nothing.
    expected = [0, 0, 0, 0, 0, 0, 0.5 / math.e, 0.5, 0.5]
    np.testing.assert_allclose([pay["stand"] for pay in pays], expected, atol=1e-12)
    assert sum(pay["jump"] for pay in pays) == pytest.approx(2.0 * (0.115 - 0.005) / 0.1)


def test_standing_after_a_low_jump_is_worth_half_of_the_square_of_its_height():
    task = JumpSettings(commands={"jump": JumpCommand(levels=[0.48])}).build(
        RobotSettings("biped"), Reward({"stand": StandAfterJump(weight=1.0)})
    )
    assert played(task)[-1][1]["stand"] == pytest.approx(0.5 * (0.12 / 0.48) ** 2)


def test_pay_of_the_place(quadruped):
    simulation = Simulation(quadruped, 1, threads=1)
    simulation.reset(np.ones(1, dtype=bool))
    base = simulation.now.base.copy()
    base[..., quadruped.facts.base.index("side"), 0] = -0.4
    now = replace(simulation.now, position=np.array([0.3]), base=base)
    step = Step(now, {}, {}, np.zeros((1, 12)), np.zeros(1, dtype=bool), quadruped.facts, {})
    assert LeaveSpot(weight=-2.0)(step) == pytest.approx(-2.0 * 0.5)


@pytest.mark.parametrize(("seconds", "succeeds"), [(0.06, True), (0.08, False)])
def test_the_end_succeeds_after_standing_for_long_enough(biped, seconds, succeeds):
    """It has stood for three steps of 20 ms at the time limit of nine steps, and before it nothing ends."""
    task = task_of(
        commands={"jump": JumpCommand(levels=[0.1])},
        terminations={
            "finish": JumpedAndStood(9, seconds),
            "time_limit": type(biped.terminations["time_limit"])(9),
            "fall": biped.terminations["fall"],
        },
    )
    outcomes = [outcome for *_, outcome in played(task)]
    assert [bool(one.truncated) for one in outcomes] == 8 * [False] + [True]
    assert [bool(one.success) for one in outcomes] == 8 * [False] + [succeeds]
    assert not any(one.terminated for one in outcomes)


def test_numpy_and_torch_agree(biped):
    terms = {**jump_terms(), "finish": JumpedAndStood(9, 0.02)}
    del terms["fall"], terms["effort"], terms["tilt"], terms["action_rate"]
    found = []
    for convert in (np.asarray, torch.as_tensor):
        seen = [Measurement(**{f.name: convert(getattr(now, f.name)) for f in fields(now)}) for now in EPISODE]
        memory = {one.name: one.begin(seen[0], biped.facts) for one in (GROUNDED, APEX, STOOD)}
        memory |= {STEPS: convert(np.array(0)), HEIGHT: convert(np.array([0.1]))}
        row = []
        for now in seen[1:]:
            step = Step(now, memory, {}, convert(np.zeros(6)), convert(np.array(False)), biped.facts, {})
            after = {one.name: one.update(memory[one.name], step) for one in (GROUNDED, APEX, STOOD)}
            memory = {**after, STEPS: memory[STEPS] + 1, HEIGHT: memory[HEIGHT]}
            step = replace(step, after=memory)
            values = {**memory, **{name: term(step) for name, term in terms.items()}}
            assert all(isinstance(value, torch.Tensor) is (convert is torch.as_tensor) for value in after.values())
            row.append({name: np.asarray(value) for name, value in values.items()})
        found.append(row)
    for ours, theirs in zip(*found, strict=True):
        for name in ours:
            assert ours[name].dtype.kind == theirs[name].dtype.kind, name
            np.testing.assert_allclose(ours[name], theirs[name], atol=1e-6, err_msg=name)


# Command and clock.


def test_each_level_is_drawn_about_as_often():
    drawn = JumpCommand(levels=[0.1, 0.15, 0.2])(np.random.default_rng(0), 3000)
    levels, counts = np.unique(drawn, return_counts=True)
    assert drawn.shape == (3000, 1) and levels.tolist() == [0.1, 0.15, 0.2] and counts.min() > 900


@pytest.mark.parametrize("levels", [[], [0.2, 0.1], [0.1, 0.1], [0.02], [math.inf], [math.nan]])
def test_wrong_levels_are_named(levels):
    with pytest.raises(ConfigError, match=r"levels must hold heights of at least 0.03 m that rise, got \["):
        JumpCommand(levels=levels)


def test_a_level_above_the_legs_length_is_named():
    with pytest.raises(ConfigError, match=r"commands\.jump\.levels must be at most 0\.5\d+ m.* got \[0\.1, 0\.7\]"):
        task_of(commands={"jump": JumpCommand(levels=[0.1, 0.7])})


def test_a_task_without_its_command_is_named():
    for commands in ({}, {"jump": UniformCommand()}):
        with pytest.raises(ConfigError, match="commands must hold a JumpCommand by the name jump"):
            JumpSettings(commands=commands)


@pytest.mark.parametrize(
    ("settings", "said"),
    [({"period": 0.0}, "period"), ({"multiples": []}, "multiples"), ({"multiples": [1, 2, 2]}, "multiples")],
)
def test_wrong_clocks_are_named(settings, said):
    with pytest.raises(ConfigError, match=said):
        JumpClock(**settings)


def test_observations_show_the_command_and_the_time(biped):
    """The policy's clock is what software computes from the contract, and gives back the time."""
    assert biped.command_ranges() == {"command_height_dm": (1.0, 1.0)}
    simulation = Simulation(biped, 2, threads=1)
    simulation.reset(np.ones(2, dtype=bool))
    nodes = []
    for _ in range(100):
        nodes.append(biped.node_features(simulation.now, simulation.memory))
        simulation.step(np.zeros((2, 6)))
    time = 0.02 * np.arange(100)
    stacked = np.tile(np.stack(nodes), biped.history)
    np.testing.assert_allclose(biped.shown_command(stacked), np.full((100, 2, 1), 0.1), atol=1e-6)
    np.testing.assert_allclose(biped.phase(torch.from_numpy(stacked))[:, 0], time / 3.0, atol=1e-5)
    clocks = [feature for node in sensed(biped, np.stack(nodes)[:, 0]) for feature in node.features if feature.clock_hz]
    assert [one.clock_hz for one in clocks] == pytest.approx([k / 3 for k in (1, 1, 2, 2, 4, 4, 8, 8)])
    for one in clocks:
        shown = np.stack(nodes)[(slice(None), 0, *biped.table.place(one.reading))]
        np.testing.assert_allclose(shown, np.sin(2 * np.pi * (one.clock_hz * time + one.clock_phase)), atol=1e-5)
    assert task_of(features={**jump_features(), "command": None}).shown_command is None


@pytest.mark.parametrize("robot", ["biped", "quadruped"])
def test_both_backends_agree(robot):
    task = JumpSettings().build(RobotSettings(robot)).with_commands({"jump": JumpCommand(levels=[0.1])})
    simulation, env = Simulation(task, 1, threads=1), load(task)
    simulation.reset(np.ones(1, dtype=bool))
    env.reset()
    nq, nv = task.robot.model.nq, task.robot.model.nv
    with env.physics.reset_context():
        env.physics.data.qpos[:] = simulation.qpos[0]
        env.physics.data.qvel[:] = simulation.state[0, 1 + nq : 1 + nq + nv]
    env.task.restart(env.physics)
    rng = np.random.default_rng(0)
    # A leg's hip, knee and ankle crouch, push and are drawn up.
    poses = [[0.7, -0.3, 0.7]] * 20 + [[0.0, 1.0, -0.5]] * 7 + [[-1.0, -1.0, -1.0]] * 8
    for pose in poses:
        action = np.tile(pose, len(task.robot.feet)) + rng.uniform(-0.1, 0.1, task.facts.actions)
        outcome, step = simulation.step(action[None]), env.step(action)
        nodes = task.node_features(simulation.now, simulation.memory)[0]
        np.testing.assert_allclose(step.observation["nodes"], nodes, atol=1e-5)
        counters = task.counters(simulation.memory, simulation.now)[0]
        np.testing.assert_allclose(step.observation["counters"], counters, atol=1e-5)
        assert step.reward == pytest.approx(float(outcome.reward[0]), abs=1e-5)
    assert robot == "quadruped" or float(simulation.memory[APEX.name][0]) > 0.02
