"""The Gymnasium environments agree with the TorchRL environment; ``test_checkers.py`` checks their form."""

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode

import gctd3
from gctd3.errors import ConfigError, RobotError

BIPED = "gctd3/Biped-v0"


def test_vector_env_equals_torchrl_env():
    """Equal starts and actions give equal stacks, rewards and endings until the first robot is reset."""
    robots = 5
    vector = gymnasium.make_vec(BIPED, num_envs=robots, observation="nodes")
    reference = gctd3.make_env("biped", num_envs=robots, seed=3)
    observation, _ = vector.reset(seed=3)
    state = reference.reset()
    np.testing.assert_array_equal(observation, state["nodes"].numpy())
    rng, compared = np.random.default_rng(0), 0
    for _ in range(200):
        action = rng.uniform(-1, 1, (robots, 6)).astype(np.float32)
        observation, reward, terminated, truncated, info = vector.step(action)
        state = reference.step(state.set("action", torch.from_numpy(action)))["next"]
        np.testing.assert_array_equal(observation, state["nodes"].numpy())
        np.testing.assert_allclose(reward, state["reward"][:, 0].numpy(), rtol=1e-6)
        np.testing.assert_array_equal(terminated, state["terminated"][:, 0].numpy())
        np.testing.assert_array_equal(truncated, state["truncated"][:, 0].numpy())
        terms = sum(value for name, value in info.items() if name.startswith("reward_"))
        np.testing.assert_allclose(terms, reward, rtol=1e-9)
        compared += 1
        if (terminated | truncated).any():
            break
    assert compared > 5
    assert terminated.any()


def test_ended_robots_start_anew_on_the_next_step():
    vector = gymnasium.make_vec(BIPED, num_envs=3)
    vector.reset(seed=0)
    rng, ended = np.random.default_rng(0), np.zeros(3, dtype=bool)
    restarts = 0
    for _ in range(300):
        before = ended
        observation, reward, terminated, truncated, _ = vector.step(rng.uniform(-1, 1, (3, 6)))
        frames = observation.reshape(3, 8, 5, 2)
        for robot in np.flatnonzero(before):
            restarts += 1
            assert reward[robot] == 0.0
            assert not terminated[robot]
            # Every frame of the stack is the first of the episode.
            assert (frames[robot] == frames[robot][:, :1]).all()
        ended = terminated | truncated
    assert restarts > 0


def test_single_env_is_the_vector_env_of_one():
    single, vector = gymnasium.make(BIPED), gymnasium.make_vec(BIPED, num_envs=1)
    one, _ = single.reset(seed=5)
    many, _ = vector.reset(seed=5)
    np.testing.assert_array_equal(one, many[0])
    for _ in range(20):
        action = np.full(6, 0.3, dtype=np.float32)
        one, reward, terminated, *_ = single.step(action)
        many, rewards, *_ = vector.step(action[None])
        np.testing.assert_array_equal(one, many[0])
        assert reward == rewards[0]
        if terminated:
            break


def test_bad_arguments():
    with pytest.raises(ConfigError, match="history must be at least 1, got 0"):
        gymnasium.make(BIPED, history=0)
    with pytest.raises(RobotError, match="No robot 'nobody'"):
        gymnasium.make(BIPED, robot="nobody")
    with pytest.raises(ConfigError, match="observation must be one of flat, nodes, got 'dict'"):
        gymnasium.make(BIPED, observation="dict")
    with pytest.raises(ConfigError, match="autoreset_mode must be NEXT_STEP or DISABLED, got "):
        gymnasium.make_vec(BIPED, num_envs=2, autoreset_mode=AutoresetMode.SAME_STEP)
    with pytest.raises(ConfigError, match=r"reset_mask must be a mask of 2 robots, got int64 \[2\]"):
        gymnasium.make_vec(BIPED, num_envs=2).reset(options={"reset_mask": np.array([0, 1])})


def test_flat_observation_is_the_rows_of_nodes_side_by_side():
    rows, flat = (gymnasium.make_vec(BIPED, num_envs=3, observation=shape) for shape in ("nodes", "flat"))
    assert rows.graph.num_nodes == 8 and rows.single_observation_space.shape == (8, 10)
    assert flat.single_observation_space.shape == (80,)
    for env in (rows, flat):
        env.reset(seed=2)
    action = np.linspace(-1, 1, 18, dtype=np.float32).reshape(3, 6)
    np.testing.assert_array_equal(rows.step(action)[0].reshape(3, 80), flat.step(action)[0])


def test_without_autoreset_only_masked_robots_start_anew():
    env = gymnasium.make_vec(BIPED, num_envs=3, observation="nodes", autoreset_mode=AutoresetMode.DISABLED)
    env.reset(seed=0)
    rng, ended = np.random.default_rng(0), np.zeros(3, dtype=bool)
    while not ended.any():
        action = rng.uniform(-1, 1, (3, 6))
        before, _, terminated, truncated, _ = env.step(action)
        ended = terminated | truncated
    with pytest.raises(ConfigError, match=f"The episode of robot {ended.argmax()}.* has ended"):
        env.step(action)
    after, _ = env.reset(options={"reset_mask": ended})
    np.testing.assert_array_equal(after[~ended], before[~ended])
    frames = after.reshape(3, 8, 5, 2)[ended]
    assert (frames == frames[:, :, :1]).all() and not np.array_equal(after[ended], before[ended])
    env.step(action)


VELOCITY = "gctd3/Velocity-v0"


def test_commanded_velocities_are_told_and_paid():
    """The reward's term is computed again from the info: ``3 (1 - |v - c|)``, with no average."""
    now = ["reward.terms.track.time=0"]
    vector = gymnasium.make_vec(VELOCITY, num_envs=3, robot="quadruped", threads=1, curriculum=False, overrides=now)
    vector.reset(seed=1)
    rng, command = np.random.default_rng(0), vector.simulation.memory["command.velocity"].copy()
    assert not command.any()
    for _ in range(5):
        _, _, _, _, info = vector.step(rng.uniform(-0.3, 0.3, (3, 12)).astype(np.float32))
        off = np.linalg.norm((info["moved"] - command)[:, :2], axis=1)
        np.testing.assert_allclose(info["reward_track"], 3.0 * (1.0 - off))
        command = info["command"]
    assert np.ptp(command, axis=0).max() > 0.01


def test_robots_are_those_of_the_commands():
    """A robot's own settings come with its name, and the outer configuration of Hydra stays as it was."""
    from hydra.core.global_hydra import GlobalHydra

    env = gymnasium.make(VELOCITY, robot="biped_planar", overrides=["task.commands.velocity.begin=[0.4,1.0]"]).unwrapped
    task = env._one.simulation.task
    assert task.robot.path.stem == "biped_planar" and task.terms["tilt"].weight == -1.0
    assert "velocity_width" in task.memory.remembered
    assert not GlobalHydra.instance().is_initialized()


@pytest.mark.parametrize(
    ("arguments", "error", "said"),
    [
        ({"robot": "quadrupet"}, RobotError, "quadrupet"),
        ({"overrides": ["task.commands.velocity.forward=[1,0]"]}, ConfigError, r"forward must be \[lowest, highest\]"),
        ({"overrides": ["task.commands.velocity.fast=1"]}, ConfigError, "fast"),
        ({"robot": "nowhere.xml"}, RobotError, "nowhere.xml"),
    ],
)
def test_wrong_commanded_velocities_are_named(arguments, error, said):
    with pytest.raises(error, match=said):
        gymnasium.make(VELOCITY, **arguments)
