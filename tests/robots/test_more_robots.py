"""Robots beside the paper's stand, are sensed and mirrored correctly on any base, and train."""

import mujoco
import numpy as np
import pytest
import torch
from compositions import STILL, env_of, reward, walking
from running import train
from suite_robots import load

from gctd3.data.mirror_augmentation import MirrorAugmentation
from gctd3.data.rhythm import Rhythm
from gctd3.envs.simulation import Simulation
from gctd3.robots.graph import KinematicGraph
from gctd3.robots.robot import Robot

FEET = {"biped_planar": 2, "quadruped": 4, "hexapod": 6}
FREE = ("pitch", "roll", "yaw", "side")


@pytest.fixture(scope="module", params=FEET)
def name(request):
    return request.param


@pytest.fixture(scope="module")
def other(name):
    return Robot.from_mjcf(name)


def task_of(robot, of=None, **settings):
    return walking(robot, of, contact_steps=None, hip_steps=None, **settings)


# Physics.


def test_parts_are_the_bipeds(name, other, robot):
    for i in range(other.model.nbody):
        body = other.model.body(i)
        kind = body.name.split("_")[0]
        if kind in ("thigh", "shank", "foot"):
            same = robot.model.body(f"{kind}_right")
            for number in ("mass", "inertia", "ipos"):
                np.testing.assert_array_equal(getattr(body, number), getattr(same, number))
    for joint in other.joints:
        kind = joint.name.split("_")[0]
        for part, of, to in (("joint", joint.name, f"{kind}_right"), ("actuator", joint.name, f"{kind}_right")):
            mine, theirs = getattr(other.model, part)(of), getattr(robot.model, part)(to)
            for number in ("damping", "armature", "range") if part == "joint" else ("gainprm", "biasprm", "forcerange"):
                np.testing.assert_array_equal(getattr(mine, number), getattr(theirs, number))
    legs = FEET[name]
    per_leg = 1.7324 + 0.7527 + 0.4111
    assert other.model.body_mass.sum() == pytest.approx(4.02 * legs / 2 + legs * per_leg)


def test_stands_still(other):
    data = mujoco.MjData(other.model)
    data.qpos[:] = other.standing_qpos
    for _ in range(1000):  # 5 s
        mujoco.mj_step(other.model, data)
        assert abs(data.qpos[other.vertical] - other.standing_qpos[other.vertical]) < 0.002
    assert np.abs(data.qvel).max() < 1e-3
    assert (data.sensordata[other.contact_sensors(other.feet)] > 0).all()
    assert not data.sensordata[other.contact_sensors(other.other_contact_bodies)].any()


@pytest.mark.parametrize("pose", [(0, 0.6, 0), (0.3, -0.5, 0.2), (-0.3, 0.2, 0.3), (0, 0, 0.5)])
def test_held_servos_lose_energy(other, pose):
    """A robot with held servos comes to rest however it falls; contacts that add energy would keep it hopping."""
    model, data = other.model, mujoco.MjData(other.model)
    low, high = other.action_range.T
    data.ctrl[:] = (low + high) / 2 + (high - low) / 2 * np.tile(pose, len(other.feet))
    heights = []
    for step in range(2400):  # 12 s
        mujoco.mj_step(model, data)
        if step >= 2000:
            heights.append(data.qpos[other.vertical])
    assert np.ptp(heights) < 5e-3 and np.abs(data.qvel).max() < 0.2


# The graph and what its nodes sense.


def test_nodes(name, other):
    graph = KinematicGraph.from_robot(other)
    extra = ("body_pitch",) if name == "biped_planar" else tuple(f"body_{coordinate}" for coordinate in FREE)
    grounds = ("ground",) if FEET[name] == 2 else tuple(f"ground_{i + 1}" for i in range(FEET[name] // 2))
    assert graph.nodes[: 1 + len(extra)] == ("body", *extra) and graph.nodes[-len(grounds) :] == grounds
    assert graph.num_nodes == 1 + len(extra) + 3 * FEET[name] + len(grounds)


def test_free_base_is_read_in_the_forward_frame():
    robot = Robot.from_mjcf("quadruped")
    task = task_of(robot)
    qpos, qvel = robot.standing_qpos.copy(), np.zeros(robot.model.nv)
    turn, angle = np.zeros(4), 0.3
    expected = {"roll": (1, 0, 0), "pitch": (0, 1, 0), "yaw": (0, 0, 1)}
    for coordinate, axis in expected.items():
        mujoco.mju_axisAngle2Quat(turn, np.array(axis, dtype=float), angle)
        qpos[3:7] = turn
        qvel[3:6] = 0.5 * np.array(axis)
        now = task.measure(qpos, qvel, np.zeros(robot.model.nsensordata))
        read = dict(zip(robot.base.extra, now.base, strict=True))
        for other_coordinate in expected:
            want = (angle, 0.5) if other_coordinate == coordinate else (0.0, 0.0)
            np.testing.assert_allclose(read[other_coordinate], want, atol=1e-12)
        assert now.tilt == pytest.approx(0.0 if coordinate == "yaw" else angle, abs=1e-7)
    qpos[:3] += (1.0, 0.2, -0.05)
    qvel[:3] = (0.7, 0.1, 0.0)
    now = task.measure(qpos, qvel, np.zeros(robot.model.nsensordata))
    assert (float(now.position), float(now.height), float(now.velocity)) == pytest.approx((1.0, -0.05, 0.7))
    np.testing.assert_allclose(now.base[robot.base.extra.index("side")], (0.2, 0.1))


@pytest.mark.parametrize("axis", ["x", "-x", "y", "-y"])
def test_forward_may_be_any_way(axis):
    robot = Robot.from_mjcf("quadruped", forward=axis)
    qpos = robot.standing_qpos.copy()
    qpos[:2] += robot.base.frame[0, :2] * 0.4 + robot.base.frame[1, :2] * 0.1
    coordinates = robot.base.read(qpos, np.zeros(robot.model.nv))
    assert float(coordinates["forward"][0]) == pytest.approx(0.4)
    assert float(coordinates["side"][0]) == pytest.approx(0.1)


def test_contacts_stand_at_their_ground_node():
    robot = Robot.from_mjcf("hexapod")
    task = task_of(robot)
    for foot, name in enumerate(robot.feet):
        sensors = np.zeros(robot.model.nsensordata)
        sensors[robot.contact_sensors([name])] = 1
        nodes = task.node_features(task.measure(robot.standing_qpos, np.zeros(robot.model.nv), sensors))
        expected = np.zeros((3, 2))
        expected[foot // 2, foot % 2] = 1  # the MJCF lists right before left, front before hind
        np.testing.assert_array_equal(nodes[-3:], expected)


def test_tilting_over_is_a_fall():
    robot = Robot.from_mjcf("biped_planar")
    qpos = robot.standing_qpos.copy()
    for pitch, fell in ((0.79, False), (0.81, True), (-0.81, True)):
        task = task_of(robot, reward(tilt=2.0))
        qpos[2] = pitch
        now = task.measure(qpos, np.zeros(robot.model.nv), np.zeros(robot.model.nsensordata))
        _, outcome = task.advance(task.begin(now), now)
        assert bool(outcome.terminated) is fell
        assert float(outcome.terms["tilt"]) == pytest.approx(-2.0 * abs(pitch))


# The mirror: a robot and its reflection, stepped side by side.


def test_reflected_actions_give_reflected_observations(other):
    torch.manual_seed(0)
    task = task_of(other, **STILL)
    mirror, pair = MirrorAugmentation(task.reflection(), history=1), Simulation(task, 2, threads=1)
    pair.reset(np.ones(2, dtype=bool))
    moved = 0.0
    for _ in range(12):
        action = 0.4 * torch.rand(len(other.actuated)) - 0.2
        pair.step(torch.stack([action, mirror.reflect("action", action)]).numpy().astype(float))
        nodes = torch.from_numpy(task.node_features(pair.now))
        counters = torch.from_numpy(task.counters(pair.memory))
        torch.testing.assert_close(mirror.reflect("nodes", nodes[0]), nodes[1], atol=1e-3, rtol=1e-3)
        torch.testing.assert_close(mirror.reflect("nodes", mirror.reflect("nodes", nodes)), nodes)
        assert mirror.reflect("counters", counters[0]).shape == counters[1].shape
        moved = max(moved, float((nodes[0] - nodes[1]).abs().max()))
    assert moved > 0.05


# Environments and training.


def test_both_backends_agree(other):
    task = task_of(other)
    simulation = Simulation(task, 1, threads=1)
    simulation.reset(np.ones(1, dtype=bool))
    env = load(task)
    env.reset()
    with env.physics.reset_context():
        env.physics.data.qpos[:] = simulation.qpos[0]
        env.physics.data.qvel[:] = simulation.state[0, 1 + other.model.nq : 1 + other.model.nq + other.model.nv]
    env.task.restart(env.physics)
    rng = np.random.default_rng(0)
    for _ in range(15):
        action = rng.uniform(-0.3, 0.3, len(other.actuated))
        outcome, step = simulation.step(action[None]), env.step(action)
        np.testing.assert_allclose(step.observation["nodes"], task.node_features(simulation.now)[0], atol=1e-5)
        assert step.reward == pytest.approx(float(outcome.reward[0]), abs=1e-5)


def test_rhythm_moves_pairs_half_a_period_apart(other):
    rhythm = Rhythm(other, 1, (1.0, 1.0), 0.02)
    assert float(rhythm.lag.sum()) == pytest.approx(0.5 * len(other.actuated) / 2)


def test_environment(name, other):
    env = env_of(walking(other), num_envs=2)
    rollout = env.rollout(20, break_when_any_done=False)
    assert rollout["nodes"].shape == (2, 20, KinematicGraph.from_robot(other).num_nodes, 10)
    assert torch.isfinite(rollout["nodes"]).all()


@pytest.mark.parametrize(
    "robot_name", [pytest.param(name, marks=[pytest.mark.nightly] * (name != "quadruped")) for name in FEET]
)
def test_trains(robot_name, finished, tmp_path):
    run = finished["quadruped"] if robot_name == "quadruped" else train(tmp_path / "run", f"robot={robot_name}")
    assert (run / "progress.csv").is_file()


@pytest.mark.nightly
def test_trains_on_a_file(tmp_path, other):
    file = tmp_path / "my=robot.xml"
    file.write_text(other.path.read_text())
    assert (train(tmp_path / "run", f"robot={file}") / "progress.csv").is_file()
