"""The batched environment gives dm_control's numbers, resets robots one by one, and does not depend on its threads."""

from collections import Counter
from dataclasses import fields

import numpy as np
import pytest
import torch
from compositions import STILL, env_of, reward, walk, walking
from suite_robots import load
from thinned import parametrize
from torchrl.envs.utils import check_env_specs

from gctd3.envs.factory import make_env
from gctd3.envs.settings import EnvSettings
from gctd3.envs.simulation import Simulation, substeps_of
from gctd3.errors import ConfigError, NumericalError, RobotError
from gctd3.robots.robot import Robot
from gctd3.tasks.walk import WalkSettings

ENDS = ("fall", "long_contact", "stuck_hip")
SHAPED = reward(antiphase=0.3, single_support=0.2, overspeed=0.5, swing=2.0)


def started(task, n, seed=0, threads=1):
    simulation = Simulation(task, n, seed=seed, threads=threads)
    simulation.reset(np.ones(n, dtype=bool))
    return simulation


def held(n, hold, seed=0):
    """Draw uniform random actions, each held for some steps."""
    rng, action = np.random.default_rng(seed), None
    for t in range(500):
        if t % hold == 0:
            action = rng.uniform(-1.0, 1.0, (n, 6))
        yield action


def sinusoids(n):
    """Swing the legs in antiphase at 1.5 Hz: not at all for the first robot, fully for the last."""
    size, stance, swing = np.linspace(0.0, 1.0, n)[:, None], np.array([0.1, 0.9, 0.0]), np.array([0.6, -1.0, -0.4])
    for t in range(500):
        wave = np.sin(2 * np.pi * 1.5 * 0.02 * t)
        yield np.concatenate([stance + size * swing * max(side * wave, -0.2) for side in (1.0, -1.0)], axis=1)


# Parity: N robots in one simulation, and the same robots in N dm_control environments.


def copy_state(simulation, i, env):
    env.reset()
    env.physics.set_state(simulation.state[i, 1:])  # without the time
    env.task.restart(env.physics)


def assert_parity(task, n, policy):
    """Assert that both backends agree on every step of the policy; return how many episodes ended in which way."""
    simulation, envs, seen = started(task, n), [load(task) for _ in range(n)], Counter()
    for i, env in enumerate(envs):
        copy_state(simulation, i, env)
    for action in policy:
        outcome = simulation.step(action)
        steps = [env.step(row) for env, row in zip(envs, action, strict=True)]
        here = {
            "nodes": task.node_features(simulation.now),
            "counters": task.counters(simulation.memory),
            "position": simulation.now.position[:, None],
            "success": outcome.success[:, None],
        }
        for name, value in here.items():
            there = np.stack([step.observation[name] for step in steps])
            np.testing.assert_allclose(value, there, rtol=0, atol=1e-6, err_msg=name)
        for name, value in outcome.terms.items():
            there = np.stack([env.task.outcome.terms[name] for env in envs])
            np.testing.assert_allclose(value, there, rtol=0, atol=1e-6, err_msg=name)
        np.testing.assert_allclose(outcome.reward, [step.reward for step in steps], rtol=0, atol=1e-6)
        done = outcome.terminated | outcome.truncated
        np.testing.assert_array_equal(done, [step.last() for step in steps])
        np.testing.assert_array_equal(outcome.terminated, [step.discount == 0.0 for step in steps])
        seen.update(name for name in ENDS for _ in range(np.count_nonzero(outcome.terms[name])))
        seen.update({"success": outcome.success.sum(), "truncated": outcome.truncated.sum()})
        simulation.reset(done)
        for i in np.flatnonzero(done):
            copy_state(simulation, i, envs[i])
    return +seen


@parametrize(2, "hold", [1, 5])
def test_parity_under_random_actions(robot, hold):
    # Limits so tight that random actions meet every termination.
    task = walking(robot, SHAPED, fall_height=-0.04, finish=0.1, hip_steps=25)
    seen = assert_parity(task, 4, held(4, hold))
    assert {"fall", "stuck_hip", "success"} <= set(seen)


def test_parity_under_swinging_legs(robot):
    # Short enough that the first robot stands too long, and the last one is cut off.
    task = walking(robot, contact_steps=20, time_limit=30)
    seen = assert_parity(task, 4, sinusoids(4))
    assert {"long_contact", "truncated"} <= set(seen)


@pytest.mark.dm_control
def test_both_backends_write_the_same_keys():
    def layout(backend):
        env = make_env("biped", 2, backend=backend, seed=0)
        data = env.rollout(3)
        env.close()
        return {key: (data[key].shape, data[key].dtype) for key in data.keys(True, True)}

    assert layout("batched") == layout("dm_control")


# TorchRL.


@pytest.mark.parametrize("num_envs", [1, 8])
def test_torchrl_specs(num_envs):
    env = make_env("biped", num_envs, seed=0)
    check_env_specs(env)
    assert env.batch_size == torch.Size([num_envs])


def test_only_ended_robots_start_anew(robot):
    n, task = 4, walking(robot, time_limit=60)
    env = env_of(task, seed=6, num_envs=n)
    data, reference = env.reset(), started(task, n, seed=6)
    single = task.node_features(reference.now)
    frames = [[single[i]] * 5 for i in range(n)]  # the reset's frame, repeated
    steps, endings_at_once = np.zeros(n, dtype=int), set()

    def stacks():
        return np.stack([np.concatenate(f[-5:], axis=-1) for f in frames])

    for action in held(n, 5):
        np.testing.assert_array_equal(data["nodes"], stacks())
        np.testing.assert_array_equal(data["step_count"].flatten(), steps)
        np.testing.assert_array_equal(data["is_init"].flatten(), steps == 0)

        stepped, data = env.step_and_maybe_reset(data.set("action", torch.from_numpy(action).float()))
        outcome = reference.step(action.astype(np.float32).astype(np.float64))
        for f, frame in zip(frames, task.node_features(reference.now), strict=True):
            f.append(frame)
        steps += 1
        # The last observation of an episode is its own, not that of the next one.
        np.testing.assert_array_equal(stepped["next", "nodes"], stacks())
        np.testing.assert_array_equal(stepped["next", "step_count"].flatten(), steps)
        np.testing.assert_array_equal(stepped["next", "position"].flatten(), reference.now.position.astype(np.float32))
        np.testing.assert_allclose(stepped["next", "reward"].flatten(), outcome.reward, rtol=1e-6)
        for key in ("terminated", "truncated", "success"):
            np.testing.assert_array_equal(stepped["next", key].flatten(), getattr(outcome, key))

        done = outcome.terminated | outcome.truncated
        np.testing.assert_array_equal(stepped["next", "done"].flatten(), done)
        endings_at_once.add(int(done.sum()))
        reference.reset(done)
        steps[done] = 0
        for i in np.flatnonzero(done):
            frames[i] = [task.node_features(reference.now)[i]] * 5
    # Robots ended alone, while the others went on.
    assert {0, 1} <= endings_at_once


def test_equal_seeds_give_equal_trajectories_and_different_ones_do_not():
    def rollout(env):
        torch.manual_seed(0)
        return env.rollout(100, break_when_any_done=False)

    env = make_env("biped", 3, seed=5)
    first = rollout(env)
    assert (first == rollout(make_env("biped", 3, seed=5))).all()
    assert not (first["nodes"] == rollout(env)["nodes"]).all()
    assert not (first["nodes"][:, 0] == make_env("biped", 3, seed=6).reset()["nodes"]).all()
    env.set_seed(9)
    again = rollout(env)
    env.set_seed(9)
    assert (again == rollout(env)).all()
    # Robots of one batch start differently too.
    assert len(first["nodes"][:, 0].flatten(1).unique(dim=0)) == 3


# The simulation.


def test_results_do_not_depend_on_the_number_of_threads(task):
    def states(threads):
        simulation = started(task, 8, threads=threads)
        for action in held(8, 5):
            outcome = simulation.step(action)
            yield simulation.state.copy(), outcome.reward
            simulation.reset(outcome.terminated | outcome.truncated)

    for one, two, three in zip(states(1), states(2), states(3), strict=True):
        for a, b, c in zip(one, two, three, strict=True):
            np.testing.assert_array_equal(a, b)
            np.testing.assert_array_equal(a, c)


def test_a_reset_forgets_everything(robot, tmp_path):
    # Servos with a time constant hold a state of their own, beside positions and velocities.
    file = tmp_path / "slow.xml"
    text = robot.path.read_text()
    file.write_text(text.replace("<position kp=", '<position timeconst="0.05" kp='))
    task = walking(Robot.from_mjcf(file), **STILL)
    assert task.robot.model.na == 6

    def after_reset(warm_up):
        simulation = Simulation(task, 2, threads=1)
        simulation.reset(np.ones(2, dtype=bool))
        for _ in range(warm_up):
            simulation.step(np.ones((2, 6)))
        simulation.reset(np.ones(2, dtype=bool))
        simulation.step(np.zeros((2, 6)))
        return simulation.state

    np.testing.assert_array_equal(after_reset(10), after_reset(0))


def test_a_reset_leaves_the_others_alone(task):
    simulation = started(task, 3)
    for _ in range(10):
        simulation.step(np.tile([0.0, 1.0, 0.0], (3, 2)))  # stand

    def rows():
        measured = [getattr(simulation.now, f.name)[:2].copy() for f in fields(simulation.now)]
        remembered = [values[:2].copy() for values in simulation.memory.values()]
        return [simulation.state[:2].copy(), *measured, *remembered]

    before = rows()
    assert simulation.now.feet_down.all()
    for mask in ([False, False, True], [False, False, False]):
        simulation.reset(np.array(mask))
        assert simulation.memory["step"].tolist() == [10, 10, 0]
        for old, new in zip(before, rows(), strict=True):
            np.testing.assert_array_equal(old, new)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_actions_that_are_not_finite_are_refused(task, bad):
    action = np.zeros((2, 6))
    action[1, 3] = bad
    with pytest.raises(NumericalError, match=r"finite.* of robot \d"):
        started(task, 2).step(action)


def test_substeps(robot):
    timestep = robot.model.opt.timestep
    assert [substeps_of(k * timestep, robot) for k in (1, 3, 4)] == [1, 3, 4]
    # 0.005 s, the biped's timestep, and its multiple that is nearest to each period.
    for period, nearest in ((0.0, 0.005), (-0.005, 0.005), (0.0025, 0.005), (0.0123, 0.01), (0.019, 0.02), (6.0, 5.0)):
        said = (
            rf"times 0\.005 s, the timestep of .*biped\.xml, got {period:g} s: the nearest that fits is {nearest:g} s\."
        )
        with pytest.raises(ConfigError, match=said):
            substeps_of(period, robot)


def test_a_timestep_of_nothing_is_refused():
    robot = Robot.from_mjcf("biped")
    robot.model.opt.timestep = 0.0
    with pytest.raises(RobotError, match=r"biped\.xml: the timestep must be above 0 s, got 0\.0"):
        substeps_of(0.02, robot)


def test_counts_below_one_are_refused(robot, task):
    with pytest.raises(ConfigError, match="num_envs must be at least 1, got 0"):
        Simulation(task, 0)
    with pytest.raises(ConfigError, match="threads must be at least 1, got 0"):
        Simulation(task, 1, threads=0)
    for settings, name in ((EnvSettings, "num_envs"), (EnvSettings, "threads"), (WalkSettings, "history")):
        with pytest.raises(ConfigError, match=rf"^{name} must be at least 1.*got 0"):
            settings(**{name: 0})
    with pytest.raises(ConfigError, match=r"^control_dt must be above 0 s and at most 1 s, got -0\.02"):
        walk(control_dt=-0.02)
    with pytest.raises(ConfigError, match=r"^task\.control_dt must be 1 to 1,000 times"):
        env_of(walking(robot, control_dt=0.0123), num_envs=1)
    with pytest.raises(ConfigError, match="backend must be batched, dm_control, library, got 'isaac'"):
        make_env("biped", 1, backend="isaac")
