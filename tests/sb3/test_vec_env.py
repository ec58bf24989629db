"""Robots stepped at once, for Stable-Baselines3: equal to its own ``DummyVecEnv`` around single robots."""

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from gctd3.envs.node_observation import NodeObservation
from gctd3.errors import ConfigError

pytest.importorskip("stable_baselines3")
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

from gctd3.sb3 import BatchedVecEnv
from gctd3.sb3.vec_env import rows

BIPED = "gctd3/Biped-v0"


def made(count):
    """Return functions that make a robot of Gymnasium's with a short time limit, its nodes observed."""
    return [lambda: NodeObservation(gymnasium.make("Hopper-v5", max_episode_steps=25), history=2)] * count


def test_equals_stable_baselines3s():
    """The same robots below Gymnasium's vector environment and below Stable-Baselines3's: every number and info."""
    ours = BatchedVecEnv(SyncVectorEnv(made(3), autoreset_mode=AutoresetMode.DISABLED))
    theirs = DummyVecEnv(made(3))
    assert ours.observation_space == theirs.observation_space and ours.action_space == theirs.action_space
    for env in (ours, theirs):
        env.seed(5)
    observations = [env.reset() for env in (ours, theirs)]
    rng, ends = np.random.default_rng(0), {"terminated": 0, "truncated": 0}
    for _ in range(120):
        for name in observations[0]:
            np.testing.assert_array_equal(observations[0][name], observations[1][name])
        actions = rng.uniform(-1, 1, (3, 3)).astype(np.float32) * np.array([[0.05], [1.0], [1.0]], np.float32)
        (*observations, (one, other)) = (
            list(x) for x in zip(*(env.step(actions) for env in (ours, theirs)), strict=True)
        )
        (observations, (reward, rewards), (done, dones)) = observations
        np.testing.assert_array_equal(reward, rewards)
        np.testing.assert_array_equal(done, dones)
        for mine, its in zip(one, other, strict=True):
            last, its_last = mine.pop("terminal_observation", {}), its.pop("terminal_observation", {})
            assert last.keys() == its_last.keys()
            for name in last:
                np.testing.assert_array_equal(last[name], its_last[name])
            # Theirs names it at every step, ours where an episode ended.
            cut = its.pop("TimeLimit.truncated")
            assert mine.pop("TimeLimit.truncated", False) == cut
            if last:
                ends["truncated" if cut else "terminated"] += 1
            assert mine.keys() == its.keys()
            for name in mine:
                assert np.array_equal(mine[name], its[name]), name
    assert all(ends.values()), ends


def test_robots_of_gctd3_are_those_of_its_vector_environment():
    ours = VecMonitor(BatchedVecEnv(BIPED, num_envs=4, threads=1))
    theirs = gymnasium.make_vec(BIPED, num_envs=4, threads=1, observation="nodes")
    ours.seed(3)
    observation, expected = ours.reset(), theirs.reset(seed=3)[0]
    assert ours.graph.nodes == theirs.graph.nodes and ours.get_attr("graph") == [ours.graph] * 4
    rng, returns, done = np.random.default_rng(0), np.zeros(4), np.zeros(4, dtype=bool)
    while not done.any():
        for row, node in enumerate(theirs.graph.nodes):
            np.testing.assert_array_equal(observation[node], expected[:, row])
        actions = rng.uniform(-1, 1, (4, 6)).astype(np.float32)
        observation, reward, done, infos = ours.step(actions)
        expected, rewards, terminated, truncated, info = theirs.step(actions)
        np.testing.assert_allclose(reward, rewards, rtol=1e-6)
        np.testing.assert_array_equal(done, terminated | truncated)
        assert [one["position"] for one in infos] == info["position"].tolist()
        returns += rewards
    for i in np.flatnonzero(done):
        # The observation is the next episode's first: all its frames are alike; the last one's is in the info.
        for row, node in enumerate(theirs.graph.nodes):
            np.testing.assert_array_equal(infos[i]["terminal_observation"][node], expected[i, row])
            frames = observation[node][i].reshape(5, 2)
            assert (frames == frames[0]).all()
        assert infos[i]["episode"]["r"] == pytest.approx(returns[i], rel=1e-5)


def test_infos_belong_to_those_who_have_them():
    infos = {"x": np.array([1.0, 2.0]), "late": np.array([0, 7]), "_late": np.array([False, True])}
    infos |= {"deep": {"y": np.array([3, 4]), "_y": np.array([True, False])}, "_deep": np.array([True, True])}
    assert rows(infos, 2) == [{"x": 1.0, "deep": {"y": 3}}, {"x": 2.0, "late": 7, "deep": {}}]


def test_what_robots_share_is_not_set_for_one():
    env = BatchedVecEnv(BIPED, num_envs=3, threads=1)
    env.set_attr("note", 5)
    assert env.get_attr("note", [0, 2]) == [5, 5] and env.env_is_wrapped(NodeObservation) == [False] * 3
    with pytest.raises(ConfigError, match="note can only be set for all robots"):
        env.set_attr("note", 6, indices=[1])
    with pytest.raises(ConfigError, match="reset cannot be called for a robot by itself"):
        env.env_method("reset", indices=0)


def test_environments_that_reset_themselves_are_refused():
    with pytest.raises(ConfigError, match=r"autoreset_mode must be DISABLED, got AutoresetMode\.NEXT_STEP"):
        BatchedVecEnv(gymnasium.make_vec(BIPED, num_envs=2))
