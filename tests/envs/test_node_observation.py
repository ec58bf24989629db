"""Observations by node: equal to what TorchRL's environments write, whatever robot, with stacked frames."""

import gymnasium
import numpy as np
import pytest
import torch
from torchrl.envs import GymEnv

from gctd3.envs.node_observation import NodeObservation, VectorNodeObservation
from gctd3.envs.nodes import STATIC, with_nodes
from gctd3.errors import ConfigError

# Gymnasium's older models warn of themselves.
pytestmark = pytest.mark.filterwarnings("ignore:.*settotalmass")
BIPED = "gctd3/Biped-v0"
ROBOTS = ["HalfCheetah-v5", "Ant-v5", "Walker2d-v5", "Hopper-v5", "Humanoid-v5"]


@pytest.mark.parametrize("name", ROBOTS)
def test_rows_equal_torchrls(name):
    """The same starts and actions; TorchRL stacks frames and appends constants by transforms of its own."""
    env, reference = NodeObservation(gymnasium.make(name), 3, static=True), with_nodes(GymEnv(name), 3, static=True)
    graph = reference.transform[0].sensor.graph
    assert env.graph.nodes == graph.nodes and set(env.observation_space) == set(graph.nodes)
    reference.set_seed(4)
    state = reference.reset()
    # TorchRL spends an episode on its seed.
    inner = reference.base_env._env.unwrapped
    env.reset(seed=0)
    env.unwrapped.set_state(inner.data.qpos.copy(), inner.data.qvel.copy())
    env._frames.extend([env._frame()] * 3)
    observation, rng = env._observe(None), np.random.default_rng(0)
    for _ in range(6):
        rows = state["nodes"].numpy()
        assert rows.shape == (graph.num_nodes, 3 * env.sensor.features + len(STATIC))
        for row, node in enumerate(graph.nodes):
            np.testing.assert_allclose(observation[node], rows[row], rtol=1e-6, atol=1e-6)
        action = rng.uniform(-0.4, 0.4, env.action_space.shape).astype(env.action_space.dtype)
        observation, *_ = env.step(action)
        assert observation in env.observation_space
        state = reference.step(state.set("action", torch.from_numpy(action)))["next"]


def test_the_oldest_frame_comes_first_and_an_episode_begins_with_its_first():
    env, one = (NodeObservation(gymnasium.make("Hopper-v5"), history) for history in (3, 1))
    first, _ = one.reset(seed=1)
    frames = [first] * 3
    observation, _ = env.reset(seed=1)
    for k in range(8):
        for node in env.graph.nodes:
            np.testing.assert_array_equal(observation[node], np.concatenate([frame[node] for frame in frames[-3:]]))
        action = np.full(3, 0.1 * k, dtype=np.float32)
        observation, *_ = env.step(action)
        frames.append(one.step(action)[0])
    again, _ = env.reset(seed=1)
    np.testing.assert_array_equal(again["torso"], np.tile(first["torso"], 3))


def test_own_observation_is_kept():
    env, bare = NodeObservation(gymnasium.make("Hopper-v5"), own=True), gymnasium.make("Hopper-v5")
    observation, _ = env.reset(seed=2)
    np.testing.assert_array_equal(observation["observation"], bare.reset(seed=2)[0])
    assert observation in env.observation_space


def test_nodes_of_gctd3s_robots_are_those_of_their_observation():
    rows, env = gymnasium.make(BIPED, observation="nodes"), NodeObservation(gymnasium.make(BIPED))
    expected, (observation, _) = rows.reset(seed=3)[0], env.reset(seed=3)
    action = np.full(6, 0.2, dtype=np.float32)
    for _ in range(3):
        for row, node in enumerate(env.graph.nodes):
            np.testing.assert_array_equal(observation[node], expected[row])
        expected, (observation, *_) = rows.step(action)[0], env.step(action)
    assert env.graph.nodes == rows.unwrapped.graph.nodes


def test_many_robots_at_once():
    rows = gymnasium.make_vec(BIPED, num_envs=4, observation="nodes")
    env = VectorNodeObservation(gymnasium.make_vec(BIPED, num_envs=4))
    expected, observation = rows.reset(seed=3)[0], env.reset(seed=3)[0]
    assert observation in env.observation_space
    actions = np.linspace(-1, 1, 24, dtype=np.float32).reshape(4, 6)
    for _ in range(3):
        for row, node in enumerate(env.graph.nodes):
            np.testing.assert_array_equal(observation[node], expected[:, row])
        expected, observation = rows.step(actions)[0], env.step(actions)[0]


def test_gymnasiums_robots_are_wrapped_one_by_one():
    env = gymnasium.make_vec("Hopper-v5", num_envs=2, wrappers=[NodeObservation], vectorization_mode="sync")
    one = NodeObservation(gymnasium.make("Hopper-v5"))
    observation, _ = env.reset(seed=[5, 6])
    for i, seed in enumerate((5, 6)):
        np.testing.assert_array_equal(observation["foot_joint"][i], one.reset(seed=seed)[0]["foot_joint"])


def test_the_spec_makes_the_same_environment():
    env = NodeObservation(gymnasium.make("Hopper-v5"), history=2, static=True)
    assert env.spec.make().observation_space == env.observation_space


@pytest.mark.parametrize(
    ("name", "given", "answer"),
    [
        ("Hopper-v5", {"history": 0}, "history must be at least 1, got 0"),
        ("CartPole-v1", {}, "gctd3's environments or Gymnasium's MuJoCo robots, got CartPoleEnv"),
        (BIPED, {"history": 2}, "takes no history=2 here"),
        (BIPED, {"static": True}, "takes no static=True here"),
        (BIPED, {"own": True}, "takes no own=True here"),
    ],
)
def test_wrong_arguments_are_answered(name, given, answer):
    with pytest.raises(ConfigError, match=answer):
        NodeObservation(gymnasium.make(name), **given)


def test_other_vector_environments_are_answered():
    with pytest.raises(ConfigError, match=r"takes gctd3's vector environments, got SyncVectorEnv; .*wrappers="):
        VectorNodeObservation(gymnasium.make_vec("CartPole-v1", num_envs=2, vectorization_mode="sync"))
