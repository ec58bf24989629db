"""``GraphExtractor``: the layers by hand, in Stable-Baselines3's algorithms, saved, loaded and shared."""

import copy
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.spaces import Box, Dict
from thinned import parametrize

from gctd3.envs.node_observation import NodeObservation
from gctd3.errors import ConfigError
from gctd3.robots.graph import KinematicGraph

pytest.importorskip("stable_baselines3")
import stable_baselines3
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack

from gctd3.sb3 import GraphExtractor

ALGORITHMS = ("TD3", "SAC", "PPO")
# Three nodes in a row; no robot.
GRAPH = KinematicGraph.from_edges(("hip", "knee", "ankle"), [("hip", "knee"), ("knee", "ankle")])
FEW = {"PPO": {"n_steps": 64, "batch_size": 32}}
OFF_POLICY = {"learning_starts": 20, "batch_size": 32, "buffer_size": 1000}


class Copying(gymnasium.Env):
    """Ask for a number that the last two nodes sense; one step an episode, so that it is a regression.

    The best constant action loses 1/18 in the mean: the target (k + a) / 2 of two uniform numbers in [-1/sqrt(3),
    1/sqrt(3)] has the variance (1/9 + 1/9) / 4.
    """

    action_space = Box(-1.0, 1.0, (1,), np.float32)
    observation_space = Dict({name: Box(-1.0, 1.0, (2,), np.float32) for name in GRAPH.nodes})
    constant = 1.0 / 18.0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        bound = 3.0**-0.5
        self.sensed = {n: self.np_random.uniform(-bound, bound, 2).astype(np.float32) for n in GRAPH.nodes}
        return self.sensed, {}

    def step(self, action):
        target = (self.sensed["knee"][0] + self.sensed["ankle"][0]) / 2
        return self.sensed, -float((action[0] - target) ** 2), True, False, {}


def make(algorithm, env, graph=GRAPH, seed=0, policy=None, **settings):
    kinds = {"features_extractor_class": GraphExtractor, "features_extractor_kwargs": {"graph": graph}}
    defaults = FEW["PPO"] if algorithm == "PPO" else OFF_POLICY
    return getattr(stable_baselines3, algorithm)(
        "MultiInputPolicy",
        env,
        policy_kwargs={"net_arch": [32], **kinds, **(policy or {})},
        seed=seed,
        device="cpu",
        **{**defaults, **settings},
    )


def extractors(model):
    """Return the extractors of the actor and of the critic."""
    policy = model.policy
    if hasattr(policy, "pi_features_extractor"):
        return policy.pi_features_extractor, policy.vf_features_extractor
    return policy.actor.features_extractor, policy.critic.features_extractor


# What it computes.


def test_features_by_hand():
    """Equation 7 three times, in float64 and with the adjacency of three nodes in a row typed in."""
    third, sixth, half = 1 / 3, 6**-0.5, 1 / 2
    propagation = np.array([[half, sixth, 0.0], [sixth, third, sixth], [0.0, sixth, half]])
    extractor = GraphExtractor(Copying.observation_space, GRAPH)
    assert extractor.features_dim == 3 * 16
    rng = np.random.default_rng(0)
    observations = {name: rng.normal(size=(5, 2)) for name in GRAPH.nodes}
    with torch.no_grad():
        features = extractor({name: torch.tensor(x, dtype=torch.float32) for name, x in observations.items()})
    for robot in range(5):
        x = np.stack([observations[name][robot] for name in ("hip", "knee", "ankle")])
        for layer in extractor.encoder.layers:
            x = np.maximum(propagation @ x @ layer.weight.detach().double().numpy() + layer.bias.tolist(), 0.0)
        for row in range(3):
            np.testing.assert_allclose(features[robot, 16 * row : 16 * (row + 1)], x[row], rtol=1e-4, atol=1e-6)
    assert features.shape == (5, 48) and (features > 0).any()


def test_options_of_the_encoder():
    extractor = GraphExtractor(Copying.observation_space, GRAPH, hidden=[8, 5], residual=True, norm=True, chebyshev=2)
    assert extractor.features_dim == 15
    assert [layer.weight.shape for layer in extractor.encoder.layers] == [(3 * 2, 8), (3 * 8, 5)]


def test_other_entries_are_appended():
    space = Dict({**Copying.observation_space, "goal": Box(-1, 1, (2,)), "above": Box(-1, 1, (2, 2))})
    extractor, bare = GraphExtractor(space, GRAPH), GraphExtractor(Copying.observation_space, GRAPH)
    bare.load_state_dict(extractor.state_dict())
    observation = {name: torch.randn(4, *box.shape) for name, box in space.items()}
    features = extractor(observation)
    assert extractor.features_dim == features.shape[1] == 48 + 2 + 4
    torch.testing.assert_close(features[:, :48], bare(observation))
    beside = {name: observation[name].flatten(1) for name in ("goal", "above")}
    torch.testing.assert_close(features[:, 48:], torch.cat([beside[name] for name in extractor.others], 1))


@pytest.mark.parametrize(
    ("space", "settings", "answer"),
    [
        (Box(-1, 1, (6,)), {}, "needs a Dict with an entry for each node"),
        (Dict({"hip": Box(-1, 1, (2,)), "ankle": Box(-1, 1, (2,))}), {}, "has no node knee of the graph; it has"),
        (
            Dict({"hip": Box(-1, 1, (2,)), "knee": Box(-1, 1, (3,)), "ankle": Box(-1, 1, (2,))}),
            {},
            r"vectors of one length, got hip \[2\], knee \[3\], ankle \[2\]",
        ),
        (Copying.observation_space, {"hiden": [8]}, "no 'hiden'; it has hidden, norm, .* Did you mean 'hidden'"),
        (Copying.observation_space, {"graph": "biped"}, "graph must be a KinematicGraph, got 'biped'"),
    ],
)
def test_wrong_arguments_are_answered(space, settings, answer):
    with pytest.raises(ConfigError, match=answer):
        GraphExtractor(space, **{"graph": GRAPH, **settings})


# In the algorithms.


@parametrize(2, "share", [False, True])
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_trains_saves_and_loads(algorithm, share, tmp_path):
    env = NodeObservation(gymnasium.make("Hopper-v5"), history=2)
    model = make(algorithm, env, env.graph, policy={"share_features_extractor": share})
    actor, critic = extractors(model)
    assert (actor is critic) == share and isinstance(actor, GraphExtractor)
    before = copy.deepcopy((actor.state_dict(), critic.state_dict()))
    model.learn(128 if algorithm == "PPO" else 40)
    for part, state in zip((actor, critic), before, strict=True):
        moved = {name for name, value in part.state_dict().items() if not torch.equal(value, state[name])}
        assert moved == {name for name, _ in part.named_parameters()}
    model.save(tmp_path / "model")
    loaded = type(model).load(tmp_path / "model", env=env, device="cpu")
    observation, _ = env.reset(seed=0)
    for _ in range(5):
        action, _ = model.predict(observation, deterministic=True)
        np.testing.assert_array_equal(action, loaded.predict(observation, deterministic=True)[0])
        observation, *_ = env.step(action)
    actor, critic = extractors(loaded)
    assert (actor is critic) == share
    loaded.learn(64 if algorithm == "PPO" else 30)


def test_the_saved_policy_reads_the_robot_through_the_graph():
    """The features of a node in a policy equal the graph encoder of gctd3 on TorchRL's ``"nodes"``."""
    from gctd3 import make_actor

    env = NodeObservation(gymnasium.make("Hopper-v5"), history=2)
    model = make("TD3", env, env.graph)
    actor = make_actor(env.graph, 4, 3).module
    actor.encoder.load_state_dict(model.actor.features_extractor.encoder.state_dict())
    observation, _ = env.reset(seed=1)
    nodes = torch.tensor(np.stack([observation[name] for name in env.graph.nodes]))
    tensors, _ = model.policy.obs_to_tensor(observation)
    features = model.actor.extract_features(tensors, model.actor.features_extractor)
    torch.testing.assert_close(features[0], actor.encoder(nodes))


def test_frames_that_stable_baselines3_stacks_are_history():
    """``VecFrameStack`` pads with zeros; from the third frame on both stack the same."""
    stacked = VecFrameStack(DummyVecEnv([lambda: NodeObservation(gymnasium.make("Hopper-v5"))]), 3)
    own = DummyVecEnv([lambda: NodeObservation(gymnasium.make("Hopper-v5"), history=3)])
    for env in (stacked, own):
        env.seed(0)
        env.reset()
    for _ in range(3):
        ours, theirs = (env.step(np.full((1, 3), 0.1, np.float32))[0] for env in (own, stacked))
    assert ours.keys() == theirs.keys()
    for name, value in ours.items():
        np.testing.assert_array_equal(value, theirs[name])


LEARNERS = {
    "TD3": {"learning_rate": 3e-3, "gamma": 0.0, "policy_delay": 1},
    "SAC": {"learning_rate": 1e-2, "gamma": 0.0, "ent_coef": 0.001},
    "PPO": {"learning_rate": 1e-2, "gamma": 0.0, "n_steps": 128},
}
STEPS = {"TD3": 400, "SAC": 300, "PPO": 768}


@pytest.mark.nightly
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_learns(algorithm):
    """What only two nodes sense is learned: less than half of the best constant action's loss remains."""
    settings = dict(LEARNERS[algorithm])
    if algorithm == "TD3":
        settings["action_noise"] = NormalActionNoise(np.zeros(1), np.full(1, 0.3))
    model = make(algorithm, Copying(), **settings)
    model.learn(STEPS[algorithm])
    bound, rng = 3.0**-0.5, np.random.default_rng(1)
    sensed = {name: rng.uniform(-bound, bound, (1000, 2)).astype(np.float32) for name in GRAPH.nodes}
    actions, _ = model.predict(sensed, deterministic=True)
    target = (sensed["knee"][:, 0] + sensed["ankle"][:, 0]) / 2
    assert np.mean((actions[:, 0] - target) ** 2) < Copying.constant / 2
    assert np.mean(target**2) == pytest.approx(Copying.constant, rel=0.1)


def test_without_stable_baselines3_a_line_names_what_to_install():
    code = """
import importlib.util
find = importlib.util.find_spec
importlib.util.find_spec = lambda name, *rest: None if name == "stable_baselines3" else find(name, *rest)
try:
    import gctd3.sb3
except ImportError as error:
    print(error)
"""
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert said == "gctd3.sb3 needs Stable-Baselines3: pip install 'gctd3[sb3]'.\n"
