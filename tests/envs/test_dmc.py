"""The dm_control environment passes the checks of dm_control's own suite, and TorchRL can wrap it."""

import os
import subprocess
import sys

import numpy as np
import pytest
import torch
from compositions import STILL, env_of, walking
from suite_robots import why_not
from torchrl.envs.utils import check_env_specs

from gctd3.envs.factory import make_env

if why_not():
    pytest.skip(why_not(), allow_module_level=True)
from dm_env import StepType

from gctd3.envs import dmc

FALL_AT_ONCE = {"fall_height": 1.0}  # every body is lower than 1 m above standing


@pytest.fixture(scope="module")
def env(task):
    return dmc.load(task, random=0)


def trajectory(task, seed, steps=200):
    """Return the time steps of random actions, over the ends of episodes."""
    env = dmc.load(task, random=seed)
    rng = np.random.default_rng(seed)
    return [env.reset(), *(env.step(rng.uniform(-1.0, 1.0, env.action_spec().shape)) for _ in range(steps))]


# dm_control.


def test_specs_hold_before_the_first_reset(task):
    env = dmc.load(task)
    spec = env.observation_spec()
    assert {name: (s.shape, s.dtype) for name, s in spec.items()} == {
        "nodes": ((8, 2), np.float32),
        "counters": ((4,), np.float32),
        "position": ((1,), np.float32),
        "success": ((1,), bool),
        "diverged": ((1,), bool),
    }
    action = env.action_spec()
    assert (action.shape, action.dtype) == ((6,), np.float64)
    assert action.name.split("\t")[:2] == ["hip_right", "knee_right"]
    assert (action.minimum == -1.0).all()
    assert (action.maximum == 1.0).all()


def test_every_time_step_is_as_specified(task, env):
    for step in trajectory(task, seed=0):
        assert step.observation.keys() == env.observation_spec().keys()
        for name, spec in env.observation_spec().items():
            spec.validate(step.observation[name])
            assert np.isfinite(step.observation[name]).all(), name
        if step.first():
            assert step.reward is None
        else:
            assert type(step.reward) is float
            assert np.isfinite(step.reward)


def test_no_element_of_the_observation_is_constant(task):
    steps = trajectory(task, seed=0, steps=500)
    for name in set(steps[0].observation) - {"success", "diverged"}:  # random actions never walk 15 m
        values = np.stack([step.observation[name] for step in steps])
        assert (np.ptp(values, axis=0) > 0).all(), name


def test_observations_do_not_share_memory(env):
    before = env.reset().observation
    after = env.step(np.zeros(6)).observation
    for name in before:
        assert not np.may_share_memory(before[name], after[name]), name


def test_equal_seeds_give_equal_trajectories_and_different_ones_do_not(task):
    one, same, other = (trajectory(task, seed) for seed in (1, 1, 2))
    for here, there in zip(one, same, strict=True):
        assert (here.step_type, here.reward, here.discount) == (there.step_type, there.reward, there.discount)
        for name in here.observation:
            np.testing.assert_array_equal(here.observation[name], there.observation[name], err_msg=name)
    assert not np.array_equal(one[0].observation["nodes"], other[0].observation["nodes"])


def test_every_reset_starts_an_episode_elsewhere(env):
    first, second = env.reset(), env.reset()
    assert first.first()
    assert second.first()
    # Two frames of joints; body and ground start alike.
    assert (first.observation["nodes"] != second.observation["nodes"])[1:-1].all()


def test_start_without_noise_is_the_reference_pose(robot):
    step = dmc.load(walking(robot, **STILL)).reset()
    expected = np.zeros((8, 2), np.float32)
    expected[0, 0] = 0.0235  # dropped from this height
    np.testing.assert_allclose(step.observation["nodes"], expected, atol=1e-7)


def test_the_discount_tells_termination_from_truncation(robot):
    fallen = dmc.load(walking(robot, **FALL_AT_ONCE))
    fallen.reset()
    step = fallen.step(np.zeros(6))
    assert (step.step_type, step.discount) == (StepType.LAST, 0.0)
    assert step.reward < -9.0

    limited = dmc.load(walking(robot, time_limit=3))
    limited.reset()
    steps = [limited.step(np.zeros(6)) for _ in range(4)]
    assert [step.step_type for step in steps] == [StepType.MID, StepType.MID, StepType.LAST, StepType.FIRST]
    assert [step.discount for step in steps] == [1.0, 1.0, 1.0, None]


def test_success_is_observed_at_the_finish_and_forgotten_at_the_reset(robot):
    env = dmc.load(walking(robot, finish=0.01))
    assert not env.reset().observation["success"]
    # Thrown forward at 1 m/s it is there within one control step of 0.02 s.
    env.physics.data.qvel[robot.forward] = 1.0
    env.task.restart(env.physics)
    step = env.step(np.zeros(6))
    assert (step.step_type, step.discount) == (StepType.LAST, 1.0)
    assert step.observation["success"]
    assert not env.step(np.zeros(6)).observation["success"]


@pytest.mark.parametrize(
    "action", [np.zeros(5), np.zeros((1, 6)), np.zeros(()), np.full(6, np.nan), np.array([0, 0, 0, 0, 0, np.inf])]
)
def test_impossible_actions_are_refused(env, action):
    env.reset()
    with pytest.raises(ValueError, match=r"finite and of shape \(6,\)"):
        env.step(action)


def test_actions_beyond_the_range_are_its_ends(env, robot):
    env.reset()
    env.step(np.array([2.0, -3.0, 0.0, 1.0, -1.0, 0.0]))
    low, high = robot.action_range.T
    np.testing.assert_allclose(
        env.physics.data.ctrl, [high[0], low[1], (low[2] + high[2]) / 2, high[3], low[4], (low[5] + high[5]) / 2]
    )


def test_there_is_no_outcome_before_the_first_step(env):
    env.reset()
    with pytest.raises(RuntimeError, match="not been stepped"):
        _ = env.task.outcome


@pytest.mark.nightly
def test_import_is_silent_without_a_display():
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL")}
    command = [sys.executable, "-c", "import gctd3.envs.dmc"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert "glfw" not in done.stderr.lower()


# TorchRL.


@pytest.mark.parametrize("num_envs", [1, 2])
def test_torchrl_specs(num_envs):
    env = make_env("biped", num_envs, backend="dm_control", seed=0)
    check_env_specs(env)
    assert env.batch_size == torch.Size([num_envs])
    assert env.reset()["nodes"].shape == (num_envs, 8, 10)
    assert env.rand_action()["action"].shape == (num_envs, 6)
    env.close()


def test_the_stack_holds_the_last_five_frames_oldest_first(task):
    stacked = make_env("biped", 2, backend="dm_control", seed=4)
    singles = [dmc.load(task, random=4), dmc.load(task, random=5)]
    data = stacked.reset()
    # The reset's frame is repeated.
    frames = [[env.reset().observation["nodes"]] * 5 for env in singles]
    for _ in range(8):
        for robot in range(2):
            expected = np.concatenate(frames[robot][-5:], axis=-1)
            np.testing.assert_array_equal(data["nodes"][robot], expected)
        data = stacked.rand_step(data)
        for robot, env in enumerate(singles):
            frames[robot].append(env.step(data["action"][robot].numpy()).observation["nodes"])
        data = data["next"]
    stacked.close()


def test_torchrl_ends(robot):
    def end(**endings):
        env = env_of(walking(robot, **endings), backend="dm_control", num_envs=2)
        last = env.rollout(2)["next"][:, -1]
        env.close()
        return [last[key].flatten().tolist() for key in ("terminated", "truncated", "done", "step_count")]

    assert end(**FALL_AT_ONCE) == [[True] * 2, [False] * 2, [True] * 2, [1] * 2]
    assert end(time_limit=2) == [[False] * 2, [True] * 2, [True] * 2, [2] * 2]
    assert end() == [[False] * 2, [False] * 2, [False] * 2, [2] * 2]


def test_its_end_leaves_the_number_of_threads(monkeypatch):
    monkeypatch.setattr("torchrl._THREAD_POOL_INIT", 4)
    before = torch.get_num_threads()
    env = make_env("biped", num_envs=2, backend="dm_control")
    env.reset()
    env.close()
    assert torch.get_num_threads() == before < 4
