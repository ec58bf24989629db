"""A task of custom terms with a command is the same on every backend, in checkpoints and in runs."""

import gymnasium
import numpy as np
import pytest
import torch
from compositions import env_of, reward, walk, walking
from own_terms import AskedSpeed, FollowSpeed, MissedSpeed
from resuming import assert_same_run, stopped
from running import command, train
from suite_robots import load
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

import gctd3
from gctd3.envs.checkpointing import env_state, load_env_state
from gctd3.envs.gym import BipedEnv
from gctd3.errors import ConfigError
from gctd3.files import load_tree, save_tree
from gctd3.runs.load import load_run
from gctd3.tasks.commands import UniformCommand
from gctd3.tasks.features import paper_features

ROBOTS, SEED = 5, 3
MINE = {
    "commands": {"speed": UniformCommand(every=0.1, low=(0.2,), high=(1.0,))},
    "features": {**paper_features(), "asked": AskedSpeed()},
    "ends": {"missed": MissedSpeed(steps=10)},
}
REWARD = reward(follow=FollowSpeed())
# The same on a command line.
SAID = [
    "+task.commands.speed._target_=gctd3.UniformCommand", "+task.commands.speed.every=0.1",
    "+task.commands.speed.low=[0.2]", "+task.commands.speed.high=[1.0]",
    "+task.features.asked._target_=own_terms.AskedSpeed",
    "+task.terminations.missed._target_=own_terms.MissedSpeed", "+task.terminations.missed.steps=10",
    "+reward.terms.follow._target_=own_terms.FollowSpeed",
]  # fmt: skip


@pytest.fixture(scope="module")
def mine(robot):
    return walking(robot, REWARD, **MINE)


def actions(steps, robots=ROBOTS):
    return np.random.default_rng(0).uniform(-1.0, 1.0, (steps, robots, 6)).astype(np.float32)


def test_what_is_asked_is_sensed_and_its_clock_shown(mine):
    # Height, velocity and the command at the root; the other nodes end in zeros.
    assert mine.features == 3 and [r.name for r in mine.table.readings[0]][-1] == "asked_m_s"
    assert all(row[2] is None for row in mine.table.readings[1:])
    assert mine.num_counters == 5


def test_batched_and_gymnasium_agree(mine):
    env = env_of(mine, seed=SEED, num_envs=ROBOTS)
    check_env_specs(env_of(mine, seed=SEED, num_envs=ROBOTS))
    vector = gymnasium.make_vec(
        "gctd3/Biped-v0", num_envs=ROBOTS, observation="nodes", reward=REWARD, task=walk(**MINE)
    )
    state, (observation, _) = env.reset(), vector.reset(seed=SEED)
    assert observation.shape == (ROBOTS, 8, 3 * 5)
    np.testing.assert_array_equal(observation, state["nodes"].numpy())
    asked, missed = [], 0
    for action in actions(200):
        observation, reward, terminated, truncated, info = vector.step(action)
        state = env.step(state.set("action", torch.from_numpy(action)))["next"]
        np.testing.assert_array_equal(observation, state["nodes"].numpy())
        np.testing.assert_allclose(reward, state["reward"][:, 0].numpy(), rtol=1e-6)
        np.testing.assert_array_equal(terminated, state["terminated"][:, 0].numpy())
        np.testing.assert_array_equal(truncated, state["truncated"][:, 0].numpy())
        assert np.isfinite(info["reward_follow"]).all() and info["reward_follow"].std() > 0
        asked.append(observation[:, 0, -1])
        missed += int((env.base_env.simulation.memory["missed_steps"] > 10).sum())
        if (terminated | truncated).any():
            break
    # Commands changed on the way, within their range, and somebody's episode ended by the term.
    asked = np.stack(asked)
    assert len(asked) > 10 and (np.ptp(asked, axis=0) > 0).all() and (asked >= 0.2).all() and (asked <= 1.0).all()
    assert missed > 0 and terminated.any()


def test_the_feature_and_the_reward_read_the_same_command(mine):
    env = env_of(mine, seed=SEED, num_envs=ROBOTS)
    state, simulation = env.reset(), env.base_env.simulation
    for action in actions(30):
        np.testing.assert_array_equal(state["nodes"][:, 0, -1], simulation.memory["command.speed"][:, 0].astype("f4"))
        before = simulation.memory["command.speed"][:, 0]
        outcome = simulation.step(action.astype(np.float64))
        near = np.exp(-((simulation.now.velocity - before) ** 2))
        np.testing.assert_allclose(outcome.terms["follow"], 2.0 * near - 0.1 * (action.astype(float) ** 2).sum(-1))
        state = {"nodes": torch.from_numpy(mine.node_features(simulation.now, simulation.memory))}


@pytest.mark.dm_control
def test_dm_control_runs_it(mine):
    env = env_of(mine, backend="dm_control", num_envs=2)
    check_env_specs(env)
    rollout = env.rollout(60, break_when_any_done=False)
    assert rollout["nodes"].shape == (2, 60, 8, 15) and rollout["counters"].shape == (2, 60, 5)
    for key in ("nodes", "counters", ("next", "reward")):
        assert torch.isfinite(rollout[key]).all(), key
    asked = rollout["nodes"][:, :, 0, -1]
    # A command is held for five steps of 0.02 s, then redrawn.
    assert (asked[:, 1:5] == asked[:, :1]).all() and (asked[:, 5] != asked[:, 4]).all()
    assert rollout["next", "terminated"].any()
    env.close()


def test_dm_control_agrees_with_the_batched_one(mine):
    """From equal states and commands both backends agree; the commands are copied, since their generators differ."""
    env = load(mine, random=0)
    env.reset()
    held = env.task.state_dict()["memory"]
    simulation = env_of(mine, num_envs=1).base_env.simulation
    simulation.reset(np.ones(1, dtype=bool))
    env.physics.set_state(simulation.state[0, 1:])
    env.task.restart(env.physics)
    simulation.memory["command.speed"] = env.task._memory["command.speed"][None].copy()
    for action in actions(4, 1):
        outcome, step = simulation.step(action.astype(np.float64)), env.step(action[0])
        np.testing.assert_allclose(
            step.observation["nodes"], mine.node_features(simulation.now, simulation.memory)[0], atol=1e-6
        )
        np.testing.assert_allclose(step.observation["counters"], mine.counters(simulation.memory)[0], atol=1e-6)
        assert step.reward == pytest.approx(float(outcome.reward[0]), abs=1e-6)
    assert held.keys() == simulation.memory.keys()


@pytest.mark.parametrize("backend", ["batched", "dm_control"])
@pytest.mark.parametrize("taken", [3, 40])
def test_an_environment_goes_on_as_it_would_have(mine, tmp_path, backend, taken):
    """The state holds commands, their clocks and their generator: a restored environment continues alike."""

    def follow(env, state, chosen):
        seen = []
        for action in chosen:
            step, state = env.step_and_maybe_reset(state.set("action", torch.from_numpy(action)))
            seen.append(step.clone())
        return torch.stack(seen), state

    chosen = actions(taken + 60, 2)
    env, other = (env_of(mine, seed=seed, backend=backend, num_envs=2) for seed in (SEED, SEED + 1))
    _, state = follow(env, env.reset(), chosen[:taken])
    save_tree(tmp_path / "state", {"state": state.clone().to_dict(), "env": env_state(env)})
    expected, _ = follow(env, state, chosen[taken:])
    other.reset()
    kept = load_tree(tmp_path / "state")
    load_env_state(other, kept["env"])
    found, _ = follow(other, TensorDict(kept["state"], [2]), chosen[taken:])
    for key in expected.keys(True, True):
        assert torch.equal(found[key], expected[key]), key
    assert expected["next", "done"].any() and len(expected["nodes"][..., 0, -1].unique()) > 10


def test_the_seed_says_which_commands(mine):
    """A seed given at construction and one set later give the same commands."""
    env, same, other = (env_of(mine, seed=seed) for seed in (SEED, SEED + 1, SEED + 1))
    same.set_seed(SEED)
    first = env.reset()["nodes"]
    assert torch.equal(first, same.reset()["nodes"]) and not torch.equal(first, other.reset()["nodes"])


@pytest.mark.nightly
def test_a_run_of_it_is_trained_resumed_evaluated_and_exported(tmp_path):
    whole = train(tmp_path / "whole", *SAID)
    part = stopped(tmp_path / "part", 160, *SAID)
    assert command("train", f"resume={part}") == 0
    assert_same_run(whole, part)
    loaded = load_run(whole)
    assert loaded.settings.task.commands == MINE["commands"] and loaded.setup.task.num_counters == 5
    assert gctd3.load_policy(whole)(TensorDict({"nodes": torch.zeros(2, 8, 15)}, [2]))["action"].shape == (2, 6)
    assert command("evaluate", f"run={whole}", "episodes=1", "threads=1", "robustness=true", *FEWEST) == 0
    assert command("export", f"run={whole}", f"out={tmp_path / 'policy.pt2'}", "episodes=1", "threads=1") == 0


FEWEST = ["perturbations.masses=[1.2]", "perturbations.frictions=[]", "perturbations.delays=[]"]
FEWEST += ["perturbations.impulses=[5]", "perturbations.phases=1", "perturbations.starts=1"]


def test_the_history_of_a_task_is_its_own_unless_asked_for():
    task = gctd3.WalkSettings(history=2)
    assert gctd3.make_env("biped", num_envs=2, task=task).reset()["nodes"].shape == (2, 8, 4)
    assert gctd3.make_env("biped", num_envs=2, task=task, history=3).reset()["nodes"].shape == (2, 8, 6)
    assert BipedEnv(task=task, observation="nodes").reset()[0].shape == (8, 4)
    assert BipedEnv(observation="nodes").reset()[0].shape == (8, 10)


def test_names_of_terms_are_text():
    with pytest.raises(ConfigError, match=r"terms: the names of terms must be text, got 1"):
        gctd3.Reward(terms={1: gctd3.Living()})
