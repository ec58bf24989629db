"""Our trainings and Stable-Baselines3's: the same transitions, returns and weights from the same starts and draws."""

import importlib
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
from configs import composed
from counterparts import parameters
from gymnasium.utils import seeding
from scipy import stats

from gctd3.config.build import build
from gctd3.data.exploration import Explorer
from gctd3.data.frame_buffer import FrameBuffer
from gctd3.training.trainer import Trainer

PAIRS = [("td3", "walker2d"), ("sac", "halfcheetah")]
LIMIT = 15  # steps of an episode, short to save time
NOISE = 0.8  # large enough that walkers fall within an episode
STEPS, BATCH, SEED = 90, 32, 3


@pytest.fixture
def recipe(monkeypatch):
    pytest.importorskip("stable_baselines3")
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))
    return importlib.import_module("yardstick_recipe")


@pytest.fixture
def sides(recipe, tmp_path):
    """Return a function that makes our training and their model, with short episodes, equal starts and weights."""

    def make(algo, task, random_steps=0):
        values = {"batch_size": BATCH, "capacity": 5000, "action_noise": NOISE, "random_steps": random_steps}
        values = recipe.Recipe(hidden=(16, 16), **values)
        long = f"total_frames={max(STEPS, random_steps)}"
        settings = build(composed(*recipe.ours(algo, task, values), long, "evaluation.episodes=2"))
        trainer, model = Trainer(replace(settings, logger="none"), tmp_path), recipe.theirs(algo, task, values, SEED)
        ours = trainer.collector.env
        for env in (*robots(ours), *robots(trainer.evaluations.env), *model.env.envs):
            shorten(env)
        # The state in which theirs begins its first episode.
        robots(ours)[0].unwrapped.np_random = seeding.np_random(SEED)[0]
        trainer.collector._state = ours.reset()
        for mine, theirs, join in parameters(trainer.algorithm, model).values():
            mine.data.copy_(join([parameter.data for parameter in theirs]))
        return trainer, model

    return make


def robots(env):
    """Return Gymnasium's environments inside one of ours."""
    return [robot._env for robot in env.base_env.robots]


def shorten(env):
    """Shorten an environment's episodes."""
    while not isinstance(env, gymnasium.wrappers.TimeLimit):
        env = env.env
    env._max_episode_steps = LIMIT


def draw(monkeypatch, algo, first):
    """Give both sides the same random draws, from their beginning at every call.

    Args:
        monkeypatch: Pytest's fixture.
        algo: The algorithm.
        first: Index of the draw that this side makes first in an update of SAC: 0 for actions in the batch's states, 1
            for actions in the next states.
    """
    generator = np.random.default_rng(1)
    noise = generator.standard_normal((STEPS, 6)).astype(np.float32)
    within = generator.standard_normal((STEPS, 2, BATCH, 6)).astype(np.float32)
    acting, ours, theirs = iter(noise), iter(noise), iter(noise)
    updating = iter([both[i] for both in within for i in (first, 1 - first)])
    if algo == "sac":
        drawn = lambda shape, *_, **__: torch.from_numpy(next(acting)[None] if shape[0] == 1 else next(updating))  # noqa: E731
        monkeypatch.setattr("torch.distributions.normal._standard_normal", drawn)
    monkeypatch.setattr(Explorer, "_noise", lambda *_: torch.from_numpy(next(ours)[None]))
    monkeypatch.setattr(np.random, "normal", lambda mean, sigma: mean + sigma * next(theirs))
    torch.manual_seed(2)  # of the noise on target actions

    # The transitions of a batch, without the newest, which ours cannot draw; both sides have one robot.
    shares = iter(generator.random((STEPS, BATCH)))

    def picked(below, size):
        return np.zeros(size, dtype=np.int64) if below == 1 else (next(shares) * below).astype(np.int64)

    monkeypatch.setattr(FrameBuffer, "_draw", lambda _, below: torch.from_numpy(picked(below, BATCH)))
    monkeypatch.setattr(np.random, "randint", lambda _, high, size: picked(max(high - 1, 1), size))


def collect(trainer, model, monkeypatch, algo):
    """Step both sides without an update."""
    monkeypatch.setattr(model, "train", lambda **_: None)
    draw(monkeypatch, algo, first=1)
    for _ in range(STEPS):
        trainer.replay.extend(trainer.collector.collect())
    draw(monkeypatch, algo, first=0)
    model.learn(STEPS)


@pytest.mark.parametrize(("algo", "task"), PAIRS)
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
        "dones": following["terminated"],  # theirs leaves out truncated episodes
    }
    for name, mine in pairs.items():
        other = getattr(theirs, name)
        assert mine.shape == other.shape, name
        # Theirs keeps float64, and contacts amplify differences in an action's last bits.
        apart = (mine.double() - other.double()).abs().flatten()
        assert apart.quantile(0.95) < 1e-4 and apart.max() < 0.1, name
    # Some episodes terminate and some are truncated, and no last observation is the next episode's first.
    ended = (following["terminated"] | following["truncated"])[:-1, 0]
    assert following["truncated"].any() and following["terminated"].any() == (task == "walker2d")
    follows = (following["nodes"][:-1] == ours["nodes"][1:]).all(dim=(1, 2))
    assert torch.equal(follows, ~ended)
    assert theirs.actions.abs().max() <= 1.0 and theirs.discounts is None


@pytest.mark.parametrize("algo", ["td3", *(pytest.param(algo, marks=pytest.mark.nightly) for algo in ("sac", "ddpg"))])
def test_trainings_go_the_same_way(sides, algo, monkeypatch):
    """Whole trainings agree, each with its own loop: they act, store, sample and update in the same order."""
    trainer, model = sides(algo, "halfcheetah")
    before = {name: mine.detach().clone() for name, (mine, *_) in parameters(trainer.algorithm, model).items()}
    draw(monkeypatch, algo, first=1)
    trainer.run()
    draw(monkeypatch, algo, first=0)
    # Ours begins to update with a full batch; theirs at a set time, after which it also acts by the policy.
    model.learning_starts, act = BATCH, model._sample_action
    monkeypatch.setattr(model, "_sample_action", lambda _, *rest: act(0, *rest))
    if algo == "sac":
        model.actor.action_dist.epsilon = 0.0
    model.learn(STEPS)
    assert trainer.algorithm.updates == model._n_updates == STEPS - BATCH
    for name, (mine, theirs, join) in parameters(trainer.algorithm, model).items():
        mine, theirs = mine.detach(), join(theirs).detach()
        moved, apart = (mine - before[name]).norm(), (mine - theirs).norm()
        assert apart < 0.01 * moved, name


@pytest.mark.parametrize("algo", ["td3", "sac"])
def test_both_warm_up_with_uniform_actions(sides, algo):
    trainer, model = sides(algo, "halfcheetah", random_steps=150)
    for _ in range(150):
        trainer.replay.extend(trainer.collector.collect())
    model.learn(150)
    drawn = {"ours": trainer.replay.buffer._ring["action"][:150, 0].numpy()}
    drawn["theirs"] = model.replay_buffer.actions[:150, 0]
    if algo == "td3":
        # Theirs adds the noise to them, and clips.
        assert (np.abs(drawn.pop("theirs")) == 1.0).mean() > 0.1
    for side, actions in drawn.items():
        assert stats.kstest(actions.flatten(), stats.uniform(-1, 2).cdf).pvalue > 0.01, side
        assert not (actions[1:] == actions[:-1]).any(), side


@pytest.mark.parametrize(("algo", "task"), PAIRS)
def test_both_are_evaluated_by_the_tasks_own_returns(sides, algo, task, tmp_path):
    peers = importlib.import_module("peers")
    trainer, model = sides(algo, task)
    evaluator = peers.Evaluator(trainer.settings, tmp_path / "theirs", peers.ENDLESS, threads=1)
    alone = gymnasium.make(robots(evaluator.env)[0].spec.id)
    # All episodes have one start, so that a single episode gives the expected return.
    for env in (*robots(evaluator.env), *robots(trainer.evaluations.env), alone):
        shorten(env)
        env.unwrapped._reset_noise_scale = 0.0

    seen, expected, ended = alone.reset()[0], 0.0, False
    while not ended:
        seen, reward, terminated, truncated, _ = alone.step(model.predict(seen, deterministic=True)[0])
        expected, ended = expected + reward, terminated or truncated

    def act(seen):
        return torch.as_tensor(model.predict(seen.numpy(), deterministic=True)[0])

    evaluator(act, trainer.settings.evaluation.every, 0)
    (theirs,) = importlib.import_module("gait_table").read_progress(tmp_path / "theirs" / "progress.csv")
    ours = trainer._evaluate()
    for row in (ours, theirs):
        assert row["return_mean"] == pytest.approx(expected, rel=1e-4)
        assert row["return_std"] == pytest.approx(0.0, abs=1e-3)
