"""What our trainings and Stable-Baselines3's learn from and are judged by: the same numbers from the same actions."""

import importlib
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
from configs import composed
from gymnasium.utils import seeding
from scipy import stats
from torch import nn

from gctd3.exploration import Explorer
from gctd3.settings import build
from gctd3.trainer import Trainer

TASKS = ("halfcheetah", "walker2d")
LIMIT = 15  # steps of an episode, for the sake of time
NOISE = 0.8  # so that walkers fall within that
STEPS, SEED = 90, 3


@pytest.fixture
def recipe(monkeypatch):
    pytest.importorskip("stable_baselines3")
    monkeypatch.syspath_prepend(str(Path(__file__).parent.parent / "benchmarks"))
    return importlib.import_module("yardstick_recipe")


@pytest.fixture
def sides(recipe, tmp_path):
    """Makes our training and their model as the recipe does, with short episodes, the same starts and weights."""

    def make(algo, task, random_steps=0):
        values = {"batch_size": 32, "capacity": 5000, "action_noise": NOISE, "random_steps": random_steps}
        values = recipe.Recipe(hidden=(16, 16), **values)
        settings = build(composed(*recipe.ours(algo, task, values), "evaluation.episodes=2", "evaluation.every=100"))
        trainer, model = Trainer(replace(settings, logger="none"), tmp_path), recipe.theirs(algo, task, values, SEED)
        ours = trainer.collector.env
        for env in (*robots(ours), *robots(trainer.evaluation_env), *model.env.envs):
            shorten(env)
        # What theirs begins its first episode with.
        robots(ours)[0].unwrapped.np_random = seeding.np_random(SEED)[0]
        trainer.collector._state = ours.reset()
        same_policy(trainer, model)
        return trainer, model

    return make


def robots(env):
    """Gymnasium's environments in one of ours."""
    return [robot.base_env._env for robot in env.base_env._envs]


def shorten(env):
    """Cut its episodes short."""
    while not isinstance(env, gymnasium.wrappers.TimeLimit):
        env = env.env
    env._max_episode_steps = LIMIT


def same_policy(trainer, model):
    """Copy the weights of their actor into ours."""
    layers = [module for module in model.actor.modules() if isinstance(module, nn.Linear)]
    mine = [module for module in trainer.algorithm.actor.modules() if isinstance(module, nn.Linear)]
    # Mean and deviation are two layers of theirs, one of ours.
    layers = [*([layer] for layer in layers[:2]), layers[2:]]
    with torch.no_grad():
        for layer, others in zip(mine, layers, strict=True):
            for name, parameter in layer.named_parameters():
                parameter.copy_(torch.cat([getattr(other, name) for other in others]))


def draw(monkeypatch, algo):
    """Give both sides the same draws, each from their beginning when this is called."""
    noise = np.random.default_rng(1).standard_normal((STEPS, 1, 6)).astype(np.float32)
    ours, theirs, both = iter(noise), iter(noise[:, 0]), iter(noise)
    if algo == "sac":
        drawn = lambda *_, **__: torch.from_numpy(next(both))  # noqa: E731
        monkeypatch.setattr("torch.distributions.normal._standard_normal", drawn)
    else:
        monkeypatch.setattr(Explorer, "_noise", lambda *_: torch.from_numpy(next(ours)))
        monkeypatch.setattr(np.random, "normal", lambda mean, sigma: mean + sigma * next(theirs))


def collect(trainer, model, monkeypatch, algo):
    """Let both act for some steps, without an update."""
    monkeypatch.setattr(model, "train", lambda **_: None)
    draw(monkeypatch, algo)
    for _ in range(STEPS):
        trainer.replay.extend(trainer.collector.collect())
    draw(monkeypatch, algo)
    model.learn(STEPS)


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("algo", ["td3", "sac"])
def test_batches_hold_the_same_transitions(sides, algo, task, monkeypatch):
    trainer, model = sides(algo, task)
    collect(trainer, model, monkeypatch, algo)
    # Our newest step has no successor yet.
    rows = np.arange(STEPS - 1)
    ours = trainer.replay.buffer.gather(torch.from_numpy(rows), torch.zeros(len(rows), dtype=torch.int64))
    theirs = model.replay_buffer._get_samples(rows)
    following = ours["next"]
    pairs = {
        "observations": ours["nodes"][:, 0],
        "actions": ours["action"],
        "rewards": following["reward"],
        "next_observations": following["nodes"][:, 0],
        "dones": following["terminated"],  # in theirs those that were cut short are taken out
    }
    for name, mine in pairs.items():
        other = getattr(theirs, name)
        assert mine.shape == other.shape, name
        # Theirs keeps float64, and contacts make more of the last bits of an action.
        apart = (mine.double() - other.double()).abs().flatten()
        assert apart.quantile(0.95) < 1e-4 and apart.max() < 0.1, name
    # Some episodes end in each of the ways that there are, and none in the next one's first observation.
    ended = (following["terminated"] | following["truncated"])[:-1, 0]
    assert following["truncated"].any() and following["terminated"].any() == (task == "walker2d")
    follows = (following["nodes"][:-1] == ours["nodes"][1:]).all(dim=(1, 2))
    assert torch.equal(follows, ~ended)
    assert theirs.actions.abs().max() <= 1.0 and theirs.discounts is None


@pytest.mark.parametrize("algo", ["td3", "sac"])
def test_both_warm_up_with_uniform_actions(sides, algo):
    trainer, model = sides(algo, "halfcheetah", random_steps=300)
    for _ in range(300):
        trainer.replay.extend(trainer.collector.collect())
    model.learn(300)
    drawn = {"ours": trainer.replay.buffer._ring["action"][:300, 0].numpy()}
    drawn["theirs"] = model.replay_buffer.actions[:300, 0]
    if algo == "td3":
        # Theirs adds the noise to them, and clips.
        assert (np.abs(drawn.pop("theirs")) == 1.0).mean() > 0.1
    for side, actions in drawn.items():
        assert stats.kstest(actions.flatten(), stats.uniform(-1, 2).cdf).pvalue > 0.01, side
        assert not (actions[1:] == actions[:-1]).any(), side


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("algo", ["td3", "sac"])
def test_both_are_judged_by_the_tasks_own_returns(sides, algo, task, tmp_path):
    peers = importlib.import_module("peers")
    trainer, model = sides(algo, task)
    judge = peers.Judge(trainer.settings, tmp_path / "theirs", peers.ENDLESS, threads=1)
    alone = gymnasium.make(robots(judge.env)[0].spec.id)
    # All from one start, so that one episode says what all are to come to.
    for env in (*robots(judge.env), *robots(trainer.evaluation_env), alone):
        shorten(env)
        env.unwrapped._reset_noise_scale = 0.0

    seen, expected, ended = alone.reset()[0], 0.0, False
    while not ended:
        seen, reward, terminated, truncated, _ = alone.step(model.predict(seen, deterministic=True)[0])
        expected, ended = expected + reward, terminated or truncated

    judge(lambda seen: torch.as_tensor(model.predict(seen.numpy(), deterministic=True)[0]), 100, 0)
    (theirs,) = importlib.import_module("gait_table").read_progress(tmp_path / "theirs" / "progress.csv")
    ours = trainer._evaluate()
    for row in (ours, theirs):
        assert row["return_mean"] == pytest.approx(expected, rel=1e-4)
        assert row["return_std"] == pytest.approx(0.0, abs=1e-3)
