"""Training on tasks of dm_control and Gymnasium, and errors for tasks that are not supported."""

import json
import math

import gymnasium
import numpy as np
import pytest
import torch
from compositions import library_env, library_task
from robots import FREE_LEGS, write
from running import command, rows, tiny, train
from tensordict import TensorDict

import gctd3
from gctd3.envs.factory import build_env
from gctd3.envs.nodes import STATIC, NodeSensor
from gctd3.envs.settings import EnvSettings
from gctd3.errors import ConfigError
from gctd3.runs.evaluate import table
from gctd3.runs.load import load_run
from gctd3.training.saved_configuration import load_settings

# Short episodes would need falls; an evaluation is as long as the task's episodes are.
FEW = ["env.num_envs=2", "evaluation.episodes=1", "evaluation.every=200", "total_frames=120"]
WITHOUT = ["env.num_envs", "env.threads", "evaluation.every", "evaluation.episodes", "total_frames"]


@pytest.mark.parametrize(
    "task, nodes, actions",
    [
        pytest.param("walker_walk", 9, 6, marks=[pytest.mark.dm_control, pytest.mark.nightly]),
        ("walker2d", 9, 6),
        pytest.param("halfcheetah", 9, 6, marks=pytest.mark.nightly),
        pytest.param("ant", 15, 8, marks=pytest.mark.nightly),
    ],
)
def test_trains_and_evaluates(tmp_path, task, nodes, actions, capsys):
    run = train(tmp_path / "run", "algo=gctd3", f"task={task}", *FEW, without=WITHOUT)
    (row,) = rows(run)
    assert int(row["frames"]) == 120 and int(row["updates"]) > 0 and math.isfinite(float(row["return_mean"]))
    assert load_settings(run).stop_when.evaluations is None
    policy = gctd3.load_policy(run)
    assert policy(TensorDict({"nodes": torch.randn(3, nodes, 4)}, [3]))["action"].shape == (3, actions)
    trained = capsys.readouterr().out
    assert command("evaluate", f"run={run}", "episodes=1") == 0
    report = json.loads((run / "evaluation.json").read_text(encoding="utf-8"))
    assert report["task"] == load_settings(run).task.name
    # dm_control's rewards lie in [0, 1], and an episode has 1,000 steps.
    assert 0 <= report["return_mean"] <= 1000 or task != "walker_walk"
    evaluated = capsys.readouterr().out
    # The output has the task's figures, no number of the paper's, and no command that would refuse this run.
    assert "gctd3.evaluate run=" in trained and "gctd3.view" not in trained
    assert "Best evaluation" in trained and "success" not in trained.partition("Best evaluation")[2]
    assert all(figure in evaluated for figure in ("episodes", "return", "velocity, m/s", "distance, m"))
    assert not any(figure in evaluated for figure in ("380.0", "paper", "success", "body position", "no gait"))
    assert command("evaluate", f"run={run}", "episodes=1", "reward=table3") == 2
    assert f"reward.terms must be empty for {report['task']}, which brings its own" in capsys.readouterr().err
    assert command("render", f"run={run}", f"out={tmp_path / 'walk.png'}") == 2
    assert "film is for tasks that gctd3 simulates" in capsys.readouterr().err


def test_a_robot_that_cannot_walk_has_no_velocity_to_show():
    report = {"task": "cartpole-balance", "episodes": 3, "return_mean": 12.0, "return_std": 1.5, "gait": {}}
    said = table({**report, "velocity_mean": 0.0, "distance_mean": 0.0, "success_rate": 0.0})
    assert [line.split()[:2] for line in said.splitlines()[1:]] == [["episodes", "3"], ["return", "12.0"]]


@pytest.mark.parametrize("algorithm", ["sac", pytest.param("ddpg", marks=pytest.mark.nightly)])
def test_other_algorithms_train_too(tmp_path, algorithm):
    run = train(tmp_path / "run", f"algo={algorithm}", "task=walker2d", *FEW, without=WITHOUT)
    settings = load_settings(run)
    assert settings.exploration.warmup == "uniform" or algorithm == "sac"
    assert (settings.exploration.noise is None) == (algorithm == "sac")


def test_rewards_and_ways_are_the_tasks_own():
    env = library_env("gymnasium", "Walker2d-v5", num_envs=2, seed=5, history=2)
    actions = torch.rand(2, 12, 6, generator=torch.Generator().manual_seed(0)) * 2 - 1
    state, seen = env.reset(), []
    theirs = gymnasium.make("Walker2d-v5")
    assert library_task("gymnasium", "Walker2d-v5").control_dt == pytest.approx(theirs.unwrapped.dt)
    # From the state in which ours starts, theirs goes on with the same rewards.
    theirs.reset()
    inner = env.base_env.robots[0]._env.unwrapped
    theirs.unwrapped.set_state(inner.data.qpos.copy(), inner.data.qvel.copy())
    for t in range(12):
        state = env.step(state.set("action", actions[:, t]))["next"]
        _, reward, ended, *_ = theirs.step(actions[0, t].numpy())
        seen.append(reward)
        assert state["reward"][0].item() == pytest.approx(reward, abs=1e-4)
        assert state["position"][0].item() == pytest.approx(theirs.unwrapped.data.qpos[0], abs=1e-4)
        assert state["counters"].shape == (2, 0) and not state["success"].any()
        if ended:
            break
    assert np.std(seen) > 0 and state["nodes"].shape == (2, 9, 4)


@pytest.mark.nightly
@pytest.mark.dm_control
def test_dm_controls_period_and_time_limit():
    from dm_control import suite

    task = library_task("dm_control", "walker-walk")
    assert task.control_dt == suite.load("walker", "walk").control_timestep() == 0.025
    env = library_env("dm_control", "walker-walk")
    rollout = env.rollout(1001, break_when_any_done=True)
    assert rollout.shape == (1, 1000)
    last = rollout["next"][0, -1]
    assert last["truncated"].item() and not last["terminated"].item()


def test_actions_are_scaled_to_the_limits_of_the_task():
    env, theirs = library_env("gymnasium", "Humanoid-v5"), gymnasium.make("Humanoid-v5")
    assert theirs.action_space.high.max() == pytest.approx(0.4)
    state = env.reset()
    theirs.reset()
    inner = env.base_env.robots[0]._env.unwrapped
    theirs.unwrapped.set_state(inner.data.qpos.copy(), inner.data.qvel.copy())
    for _ in range(5):
        action = torch.rand(1, 17) * 2 - 1
        state = env.step(state.set("action", action))["next"]
        _, reward, *_ = theirs.step(0.4 * action[0].numpy())
        assert state["reward"].item() == pytest.approx(reward, rel=1e-4)
    np.testing.assert_allclose(inner.data.qvel, theirs.unwrapped.data.qvel, atol=1e-3)


@pytest.mark.dm_control
def test_actions_of_dm_control_are_scaled_too():
    env = library_env("dm_control", "quadruped-walk")
    physics = env.base_env.robots[0]._env.physics
    limits = physics.model.actuator_ctrlrange
    assert not (limits == [-1, 1]).all()
    state = env.reset()
    for end, action in enumerate((-1.0, 1.0)):
        state = env.step(state.set("action", torch.full((1, len(limits)), action)))["next"]
        np.testing.assert_allclose(physics.control(), limits[:, end])


@pytest.mark.nightly
def test_feet_and_forward_are_those_named(tmp_path, capsys):
    named = ["task=walker2d", "robot.feet=[foot_left]", "robot.forward=-x"]
    run = train(tmp_path / "run", "algo=gctd3", *named, *FEW, without=WITHOUT)
    robot = load_run(run).setup.robot
    assert (robot.feet, robot.forward_axis) == (("foot_left",), "-x")
    assert command("evaluate", f"run={run}", "episodes=1") == 0
    assert library_task("gymnasium", "Walker2d-v5").robot.feet == ("foot", "foot_left")
    ways = []
    for asked in ({}, {"feet": ["foot_left"], "forward": "-x"}):
        env = library_env("gymnasium", "Walker2d-v5", **asked)
        ways.append(env.step(env.reset().set("action", torch.ones(1, 6)))["next", "position"])
    assert torch.equal(ways[0], -ways[1]) and ways[0].abs().max() > 0
    capsys.readouterr()
    for wrong, message in [
        ("robot.feet=[nonsense]", "has no body 'nonsense'"),
        ("robot.feet=[torso]", "foot 'torso' hangs on no joint"),
        ("robot.name=quadruped", "robot.name must be left at biped for a library's task, got 'quadruped'"),
        ("robot=my.xml", "got 'my.xml': the task brings its own robot"),
        # On a free base, which other tasks train with settings of its own.
        (f"robot={write(tmp_path, FREE_LEGS)}", "robot.xml': the task brings its own robot"),
    ]:
        wrong = tiny(tmp_path / "wrong", "task=walker2d", wrong, *FEW, without=WITHOUT)
        assert command("train", *wrong) == 2
        assert message in capsys.readouterr().err
        assert not (tmp_path / "wrong").exists()


def test_equal_seeds_start_equally():
    one, again, other = (
        library_env("gymnasium", "HalfCheetah-v5", num_envs=3, seed=seed).reset()["nodes"] for seed in (3, 3, 4)
    )
    assert torch.equal(one, again) and not torch.equal(one, other) and not torch.equal(one[0], one[1])


@pytest.mark.parametrize(
    "library, name, size", [("gymnasium", "HalfCheetah-v5", 17), ("dm_control", "walker-walk", 24)]
)
def test_the_tasks_own_observation(library, name, size):
    task = library_task(library, name, history=1, observation="flat")
    assert task.features == size and task.graph.nodes == ("observation",)
    env = library_env(library, name, num_envs=2, history=1, observation="flat")
    state = env.reset()
    action = torch.zeros(2, env.action_spec.shape[-1])
    for _ in range(3):
        state = env.step(state.set("action", action))["next"]
    assert state["nodes"].shape == (2, 1, size)
    inner = env.base_env.robots[0]._env
    if library == "gymnasium":
        theirs = inner.unwrapped._get_obs()
    else:
        theirs = np.concatenate([np.ravel(part) for part in inner.task.get_observation(inner.physics).values()])
    np.testing.assert_allclose(np.sort(state["nodes"][0, 0]), np.sort(theirs), rtol=1e-6)
    if library == "gymnasium":  # in its order
        np.testing.assert_allclose(state["nodes"][0, 0], theirs, rtol=1e-6)
    # The nodes' features are still read beside it, for the gait metrics.
    noded = library_env(library, name, num_envs=2, history=1)
    other = noded.reset()
    for _ in range(3):
        other = noded.step(other.set("action", action))["next"]
    assert torch.equal(torch.from_numpy(env.base_env.sensed), other["nodes"])
    seen, expected = env.base_env.glance(), noded.base_env.glance()
    for part in ("height", "hips", "feet_down"):
        np.testing.assert_array_equal(getattr(seen, part), getattr(expected, part))
    np.testing.assert_array_equal(seen.height, other["nodes"][:, 0, 0])


@pytest.mark.nightly
def test_trains_on_the_tasks_own_observation(tmp_path, capsys):
    flat = ["task=walker2d", "task.observation=flat", *FEW]
    run = train(tmp_path / "run", "algo=td3", *flat, without=WITHOUT)
    policy = gctd3.load_policy(run)
    assert policy(TensorDict({"nodes": torch.randn(3, 1, 34)}, [3]))["action"].shape == (3, 6)
    assert command("evaluate", f"run={run}", "episodes=1") == 0
    for network in ("gcn", "per_joint"):
        wrong = tiny(tmp_path / network, "algo=td3", f"network={network}", *flat, without=WITHOUT)
        assert command("train", *wrong) == 2
        assert "task.observation must be nodes for a network that knows the robot's graph" in capsys.readouterr().err


@pytest.mark.nightly
def test_trains_on_nodes_that_say_what_they_are(tmp_path, capsys):
    static = ["task=walker2d", "task.static=true", *FEW]
    run = train(tmp_path / "run", "algo=gctd3", *static, without=WITHOUT)
    loaded = load_run(run)
    env = build_env(loaded.setup.task, loaded.settings.env, seed=0)
    state = env.reset()
    for _ in range(3):
        state = env.step(state.set("action", torch.ones(2, 6)))["next"]
    # Two frames of sensed features, of which only the newest is compared, and the same constant features in both.
    older, newest = state["nodes"].unflatten(-1, (2, 2 + len(STATIC))).unbind(-2)
    assert torch.equal(newest[..., :2], torch.from_numpy(env.base_env.sensed))
    assert not torch.equal(older[..., :2], newest[..., :2])
    described = torch.from_numpy(NodeSensor(loaded.setup.robot.model).static())
    assert torch.equal(older[0, :, 2:], described) and torch.equal(newest[1, :, 2:], described)
    policy = gctd3.load_policy(run)
    assert policy(state)["action"].shape == (2, 6)
    # The policy reads it.
    other = state.clone()
    other["nodes"][..., 2:13] += 1.0
    assert not torch.equal(policy(other)["action"], policy(state)["action"])
    assert command("evaluate", f"run={run}", "episodes=1") == 0
    for wrong, message in [
        (["algo=td3", "network=mlp", "task.observation=flat"], "static must be false for observation=flat"),
        (["algo=gctd3", "network=equivariant"], "network.equivariant must be false for Walker2d-v5 with"),
    ]:
        assert command("train", *tiny(tmp_path / "wrong", *static, *wrong, without=WITHOUT)) == 2
        assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    "library, name, message",
    [
        ("dm_control", "walker", "dm_control cannot make 'walker'"),
        ("gymnasium", "Nothing-v0", "gymnasium cannot make 'Nothing-v0'"),
        ("dm_control", "lqr-lqr_2_1", r"actions of 'lqr-lqr_2_1' must have limits, to be scaled to \[-1, 1\]"),
        ("gymnasium", "Pendulum-v1", "one MuJoCo robot"),
    ],
)
def test_tasks_that_cannot_be(library, name, message):
    with pytest.raises(ConfigError, match=message):
        library_task(library, name)


def test_settings_that_do_not_fit(tmp_path, capsys):
    assert command("train", "task=walker2d", "replay.mirror=true", f"hydra.run.dir={tmp_path}") == 2
    said = "replay.mirror must be false for Walker2d-v5, got true: mirror is for simulated tasks."
    assert said in capsys.readouterr().err
    with pytest.raises(ConfigError, match="num_envs must be at least 1, got 0"):
        EnvSettings("library", num_envs=0)
