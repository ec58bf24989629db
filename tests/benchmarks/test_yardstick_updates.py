"""Our updates and Stable-Baselines3's, from equal weights, batches and draws, give equal parameters and targets."""

import importlib
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from configs import composed
from counterparts import parameters
from scipy import stats
from tensordict import TensorDict

from gctd3.config.build import build

ALGORITHMS = ("td3", "sac", "ddpg")
UPDATES, BATCH = 6, 64
SEEN, ACTIONS = 17, 6  # HalfCheetah's


@pytest.fixture(autouse=True)
def _double():
    """Compute in float64: Adam divides by a gradient's size, where float32 would compare rounding errors."""
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(torch.float32)


@pytest.fixture
def recipe(monkeypatch):
    pytest.importorskip("stable_baselines3")
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))
    # Theirs converts observations to float32.
    monkeypatch.setattr("stable_baselines3.common.policies.preprocess_obs", lambda seen, *_, **__: seen)
    return importlib.import_module("yardstick_recipe")


def sides(recipe, algo):
    """Return our algorithm and their model, made from the recipe."""
    from stable_baselines3.common.logger import Logger

    values = recipe.Recipe(hidden=(24, 16), batch_size=BATCH, capacity=1000, learning_rate=1e-3, tau=0.05)
    ours = build(composed(*recipe.ours(algo, "halfcheetah", values)))
    algorithm, model = ours.algo.build(ours.setup().architecture()), recipe.theirs(algo, "halfcheetah", values, seed=0)
    model.set_logger(Logger(None, []))
    return algorithm, model


def optimisers(algorithm, model):
    """Return both sides' optimisers, by name."""
    theirs = {"critic": model.critic.optimizer, "actor": model.actor.optimizer}
    if "alpha" in algorithm.optimizers:
        theirs["alpha"] = model.ent_coef_optimizer
    return {name: (algorithm.optimizers[name], other) for name, other in theirs.items()}


def batch():
    """Return the same transitions for both sides; some terminate, some are truncated."""
    fate = torch.randint(5, (BATCH, 1))
    terminated, truncated = fate == 0, fate == 1
    seen, after, action = torch.randn(BATCH, SEEN), torch.randn(BATCH, SEEN), 2 * torch.rand(BATCH, ACTIONS) - 1
    reward = 3 * torch.randn(BATCH, 1)
    following = {"nodes": after[:, None], "counters": torch.zeros(BATCH, 0), "reward": reward}
    following |= {"terminated": terminated, "truncated": truncated, "done": terminated | truncated}
    ours = {"nodes": seen[:, None], "counters": torch.zeros(BATCH, 0), "action": action, "next": following}
    # Their buffer's dones leave out truncated episodes.
    theirs = {"observations": seen, "actions": action, "next_observations": after, "rewards": reward}
    theirs |= {"dones": terminated.double(), "discounts": None}
    return TensorDict(ours, [BATCH]).auto_batch_size_(1), SimpleNamespace(**theirs)


def differences(algorithm, model):
    """Return the largest difference of every parameter, and of its optimiser's state."""
    found = {}
    for name, (mine, theirs, join) in parameters(algorithm, model).items():
        found[name] = (mine.data - join([parameter.data for parameter in theirs])).abs().max().item()
        if name.startswith("target_"):
            continue
        my_adam, their_adam = optimisers(algorithm, model)[name.split(".")[0]]
        for key in ("exp_avg", "exp_avg_sq", "step"):
            if mine not in my_adam.state and not any(parameter in their_adam.state for parameter in theirs):
                continue
            values = [their_adam.state[parameter][key] for parameter in theirs]
            other = join(values) if key != "step" else values[0]
            found[f"{name} {key}"] = (my_adam.state[mine][key] - other).abs().max().item()
    return found


@pytest.mark.parametrize("algo", ALGORITHMS)
def test_both_begin_with_weights_of_the_same_distribution(recipe, algo):
    algorithm, model = sides(recipe, algo)
    found = {
        name: (mine.detach(), join(theirs).detach())
        for name, (mine, theirs, join) in parameters(algorithm, model).items()
    }
    for name, (mine, theirs) in found.items():
        if name == "alpha":
            assert float(mine) == pytest.approx(float(theirs))
        elif name.startswith("target_"):
            for one, other in zip((mine, theirs), found[name.removeprefix("target_")], strict=True):
                assert torch.equal(one, other), name
        else:
            # PyTorch's: weights and biases uniform up to one over the root of a unit's inputs.
            kind, i = name.split(".")
            reads = found[f"{kind}.{int(i) // 2 * 2 + 1}"][0].shape[-1]
            for one in (mine, theirs):
                drawn = one.flatten().numpy() * reads**0.5
                assert stats.kstest(drawn, stats.uniform(-1, 2).cdf).pvalue > 1e-3, name
            if kind == "critic" and algo != "ddpg":
                assert not torch.equal(*mine) and not torch.equal(*theirs)


@pytest.mark.parametrize("algo", ALGORITHMS)
def test_updates_leave_the_same_behind(recipe, algo, monkeypatch):
    algorithm, model = sides(recipe, algo)
    for mine, theirs, join in parameters(algorithm, model).values():
        mine.data.copy_(join([parameter.data for parameter in theirs]))
    if algo == "sac":
        # They add this to a logarithm's argument to keep it finite; our formula needs no such constant.
        model.actor.action_dist.epsilon = 0.0
    before = {name: mine.data.clone() for name, (mine, *_) in parameters(algorithm, model).items()}
    torch.manual_seed(1)
    for update in range(UPDATES):
        ours, theirs = batch()
        here, there = torch.randn(BATCH, ACTIONS), torch.randn(BATCH, ACTIONS)

        def draw_in_turn(*draws):
            left = list(draws)
            monkeypatch.setattr("torch.distributions.normal._standard_normal", lambda *_, **__: left.pop(0))
            torch.manual_seed(update)  # noqa: B023 - called at once

        state = torch.get_rng_state()
        draw_in_turn(there, here)
        algorithm.update(ours)
        draw_in_turn(here, there)
        monkeypatch.setattr(model.replay_buffer, "sample", lambda *_, **__: theirs)  # noqa: B023 - called at once
        model.train(1, BATCH)
        torch.set_rng_state(state)
        found = differences(algorithm, model)
        assert max(found.values()) < 1e-9, {name: value for name, value in found.items() if value >= 1e-9}
    assert algorithm.updates == model._n_updates == UPDATES
    moved = [not torch.equal(before[name], mine) for name, (mine, *_) in parameters(algorithm, model).items()]
    assert all(moved)
