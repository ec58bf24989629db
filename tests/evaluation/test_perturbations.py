"""Perturbations of a robot and its policy equal hand arithmetic and MuJoCo's own forces."""

import copy
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import torch
from compositions import walking
from tensordict import TensorDict

from gctd3.envs.factory import make_env
from gctd3.evaluation.perturbations import (
    Delayed,
    Noisy,
    Pushed,
    Shoved,
    altered,
    resting_action,
    sensor_deviation,
    velocity_change,
)
from gctd3.evaluation.recorder import total_mass
from gctd3.robots.graph import KinematicGraph
from gctd3.robots.robot import Robot


def momentum(robot, qpos, qvel):
    """Return the whole robot's momentum in the world's axes (N s), computed by MuJoCo."""
    data = mujoco.MjData(robot.model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_fwdPosition(robot.model, data)
    mujoco.mj_fwdVelocity(robot.model, data)
    mujoco.mj_subtreeVel(robot.model, data)
    return total_mass(robot) * data.subtree_linvel[robot.model.body(robot.root).id]


def pose(robot, seed=0):
    rng = np.random.default_rng(seed)
    qpos = robot.model.qpos0.copy()
    qpos[[joint.qpos for joint in robot.joints]] += rng.uniform(-0.4, 0.4, len(robot.joints))
    return qpos, rng.normal(size=robot.model.nv)


@pytest.mark.parametrize("name", ["biped", "biped_planar", "quadruped"])
def test_an_impulse_changes_the_momentum_by_as_much(name):
    robot = Robot.from_mjcf(name)
    qpos, qvel = pose(robot)
    for impulse in ([7.0, 0.0, 0.0], [-3.0, 0.0, 2.0]):
        change = velocity_change(robot, qpos, np.array(impulse))
        gained = momentum(robot, qpos, qvel + change) - momentum(robot, qpos, qvel)
        # A boom holds the robot sideways.
        assert gained == pytest.approx(impulse, abs=1e-9)


def test_an_impulse_is_a_great_force_for_a_short_time(robot):
    qpos, _ = pose(robot)
    model = copy.copy(robot.model)
    model.opt.timestep = 1e-6
    # Remove all other forces: weight, servos, joint limits.
    off = mujoco.mjtDisableBit
    model.opt.disableflags |= int(off.mjDSBL_GRAVITY) | int(off.mjDSBL_ACTUATION) | int(off.mjDSBL_CONSTRAINT)
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    data.xfrc_applied[model.body(robot.root).id, 0] = 5.0 / model.opt.timestep
    mujoco.mj_step(model, data)
    assert data.qvel == pytest.approx(velocity_change(robot, qpos, np.array([5.0, 0.0, 0.0])), rel=1e-3, abs=1e-4)


def test_a_doubled_mass_is_what_mujoco_reports(robot):
    heavy = altered(robot, mass=2.0)
    assert total_mass(heavy) == pytest.approx(2 * total_mass(robot))
    assert total_mass(robot) == pytest.approx(4.02 + 2 * (1.7324 + 0.7527 + 0.4111))
    qpos, qvel = pose(robot)
    assert momentum(heavy, qpos, qvel) == pytest.approx(2 * momentum(robot, qpos, qvel))
    matrices = []
    for kind in (robot, heavy):
        data, full = mujoco.MjData(kind.model), np.zeros((kind.model.nv, kind.model.nv))
        data.qpos[:] = qpos
        mujoco.mj_forward(kind.model, data)
        mujoco.mj_fullM(kind.model, data, full)
        matrices.append(full - np.diag(kind.model.dof_armature))
    # Inertias too, but not the rotors'.
    assert matrices[1] == pytest.approx(2 * matrices[0])
    assert heavy.model.opt.gravity == pytest.approx(robot.model.opt.gravity)


def test_half_the_friction_is_what_contacts_have(robot):
    found = []
    for kind in (robot, altered(robot, friction=0.5)):
        data = mujoco.MjData(kind.model)
        data.qpos[:] = kind.standing_qpos
        data.qpos[kind.vertical] -= 0.001
        mujoco.mj_forward(kind.model, data)
        assert data.ncon > 0
        found.append(data.contact.friction)
    assert found[1] == pytest.approx(0.5 * found[0])
    assert found[0][:, 0] == pytest.approx(1.0)


def test_actions_come_late():
    counted = iter(range(1, 10))

    def policy(state):
        return state.set("action", torch.full((2, 3), float(next(counted))))

    late = Delayed(policy, 2, torch.tensor([-1.0, 0.0, 1.0]))
    seen = [late(TensorDict({}, [2]))["action"] for _ in range(4)]
    assert [action[0].tolist() for action in seen] == [[-1, 0, 1], [-1, 0, 1], [1, 1, 1], [2, 2, 2]]


def test_the_resting_action_asks_for_the_start_pose(robot):
    env = make_env("biped", num_envs=1)
    asked = env.base_env.simulation.desired(resting_action(robot).numpy()[None].astype(float))
    assert asked[0] == pytest.approx(np.zeros(6), abs=1e-6)


def test_an_error_goes_through_the_stack_with_its_frame(task):
    deviation = sensor_deviation(task, 0.1, 0.2, 0.3, 0.4)
    seen = []

    def policy(state):
        seen.append(state["nodes"].clone())
        return state.set("action", torch.zeros(500, 6))

    noisy = Noisy(policy, deviation, seed=1)
    states = [TensorDict({"nodes": torch.full((500, 8, 6), float(step))}, [500]) for step in range(3)]
    for state in states:
        assert "action" in noisy(state)
        assert (state["nodes"] == state["nodes"][0, 0, 0]).all()
    errors = [nodes - step for step, nodes in enumerate(seen)]
    first = errors[0][..., :2]
    exact = {"rtol": 0.0, "atol": 1e-6}
    torch.testing.assert_close(errors[0], first.repeat(1, 1, 3), **exact)
    torch.testing.assert_close(errors[1][..., :4], errors[0][..., 2:], **exact)
    torch.testing.assert_close(errors[2][..., :4], errors[1][..., 2:], **exact)
    assert (errors[1][..., 4:] - errors[0][..., 4:])[:, :7].abs().mean() > 0.01
    # 500 draws of two features: three frames' worth of spread around what was asked for.
    assert first.std(dim=0) == pytest.approx(deviation, rel=0.15)
    again = Noisy(policy, deviation, seed=1)
    again(states[0])
    assert (seen[-1] == seen[0]).all()


def test_what_errs_by_how_much(robot, task):
    rows = dict(zip(task.graph.nodes, sensor_deviation(task, 1, 2, 3, 4).tolist(), strict=True))
    assert rows["body"] == [3, 4] and rows["ground"] == [0, 0]
    assert all(rows[joint.name] == [1, 2] for joint in robot.joints)
    free = Robot.from_mjcf("quadruped")
    nodes = KinematicGraph.from_robot(free).nodes
    rows = dict(zip(nodes, sensor_deviation(walking(free), 1, 2, 3, 4).tolist(), strict=True))
    assert len(rows) == len(nodes)
    turns = [rows[f"{free.root}_{name}"] for name in ("pitch", "roll", "yaw")]
    assert turns == [[1, 2]] * 3 and rows[f"{free.root}_side"] == [3, 4]
    assert [rows[joint.name] for joint in free.joints] == [[1, 2]] * 12
    assert [row for name, row in rows.items() if name.startswith("ground")] == [[0, 0]] * 2


def test_pushes_come_when_they_should(robot):
    """Robots are pushed after touchdowns: the foot is down in steps 0 to 2, in the air to 5, and down from 6 on."""
    standing = np.tile(robot.model.qpos0, (2, 1))
    simulation = SimpleNamespace(
        num_robots=2, task=SimpleNamespace(robot=robot), qpos=standing, qvel=np.zeros((2, robot.model.nv)), now=None
    )
    pushed = Pushed(lambda state: state, simulation, [4.0, -2.0], [0, 3], settle=1.0, swing=3)
    speeds = []
    for step in range(12):
        down = np.array([[not 3 <= step <= 5, True]] * 2)
        # The first touch, at step 0, comes before the metre at which it would count.
        simulation.now = SimpleNamespace(feet_down=down, position=np.full(2, 0.5 + 0.1 * step))
        pushed(None)
        speeds.append(simulation.qvel[:, robot.base.single["forward"].qvel].copy())
    assert pushed.pushed_at.tolist() == [6, 9]
    speeds = np.array(speeds)
    assert (speeds[:6] == 0).all() and (speeds[6:, 0] > 0).all() and (speeds[:9, 1] == 0).all()
    # Once each, with the one twice as hard and the other way.
    assert np.ptp(speeds[6:, 0]) == 0 and speeds[-1, 0] == pytest.approx(-2 * speeds[-1, 1])


def test_robots_are_pushed_again_and_again_in_all_directions():
    """A push of 0.5 m/s changes the momentum of a free robot by 0.5 m/s times its mass, to any side, every 20 steps."""
    robot, count, steps = Robot.from_mjcf("quadruped"), 12, 61
    standing = np.tile(robot.standing_qpos, (count, 1))
    simulation = SimpleNamespace(
        num_robots=count, task=SimpleNamespace(robot=robot), qpos=standing, qvel=np.zeros((count, robot.model.nv))
    )
    shoved, before, times = Shoved(lambda state: state, simulation, 0.5, 20, seed=0), np.zeros((count, 3)), []
    for step in range(steps):
        shoved(None)
        now = np.array([momentum(robot, *both) for both in zip(simulation.qpos, simulation.qvel, strict=True)])
        change, before = now - before, now
        pushed = np.flatnonzero(np.abs(change).max(axis=1) > 1e-9)
        times += [(int(i), step) for i in pushed]
        sizes = np.linalg.norm(change[pushed], axis=1)
        np.testing.assert_allclose(sizes, 0.5 * total_mass(robot), rtol=1e-6)
        np.testing.assert_allclose(change[pushed] @ robot.base.frame[2], 0.0, atol=1e-9)
    own = [[step for robot, step in times if robot == i] for i in range(count)]
    assert all(first[0] < 20 and (np.diff(first) == 20).all() and len(first) >= 3 for first in own)
    assert len({first[0] for first in own}) > 1


def test_a_bounce_is_no_touchdown(robot):
    simulation = SimpleNamespace(num_robots=1, task=SimpleNamespace(robot=robot), now=None)
    pushed = Pushed(lambda state: state, simulation, [4.0], [0], settle=0.0, swing=3)
    for down in (True, False, False, True, True):
        simulation.now = SimpleNamespace(feet_down=np.array([[down, True]]), position=np.ones(1))
        pushed(None)
    assert pushed.pushed_at.tolist() == [-1]
