"""Our algorithms beside Stable-Baselines3's: both get equal settings, and their curves are compared correctly."""

import importlib
import json
import math
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from configs import composed
from scipy import stats
from torch import nn

from gctd3.config.build import build

ALGORITHMS = ("td3", "sac", "ddpg")
# No value is a default of either side.
UNUSUAL = {
    "learning_rate": 7e-4,
    "batch_size": 33,
    "capacity": 5000,
    "gamma": 0.97,
    "tau": 0.02,
    "hidden": (24, 12),
    "random_steps": 77,
    "action_noise": 0.17,
    "policy_delay": 3,
    "policy_noise": 0.25,
    "noise_clip": 0.4,
    "temperature": 0.5,
}


@pytest.fixture(autouse=True)
def _benchmarks_are_importable(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))


@pytest.fixture
def recipe():
    return importlib.import_module("yardstick_recipe")


@pytest.fixture
def curves():
    return importlib.import_module("yardstick_curves")


# Both sides get the same settings.


def sides(recipe, algo):
    """Return our settings, our algorithm and their model."""
    pytest.importorskip("stable_baselines3")
    unusual = recipe.Recipe(**UNUSUAL)
    ours = build(composed(*recipe.ours(algo, "halfcheetah", unusual)))
    return ours, ours.algo.build(ours.setup().architecture()), recipe.theirs(algo, "halfcheetah", unusual, seed=0)


def weights(module):
    return [parameter for parameter in module.parameters() if parameter.ndim == 2]


@pytest.mark.parametrize("algo", ALGORITHMS)
def test_both_report_the_same_hyperparameters(recipe, algo):
    ours, algorithm, theirs = sides(recipe, algo)
    estimator, exploration = algorithm.loss.value_estimator, ours.exploration
    noise = None if theirs.action_noise is None else tuple({float(s) for s in theirs.action_noise._sigma})
    pairs = {
        "batch_size": (ours.replay.batch_size, theirs.batch_size),
        "capacity": (ours.replay.buffer_size, theirs.replay_buffer.buffer_size),
        "gamma": (float(estimator.gamma), theirs.gamma),
        "tau": (1 - algorithm.targets.eps, theirs.tau),
        "random_steps": (exploration.learning_starts, theirs.learning_starts),
        "action_noise": (exploration.noise and tuple(set(exploration.noise)), noise),
        "n_steps": (ours.replay.n_step, theirs.n_steps),
        "steps between updates": (ours.rollout_steps * ours.env.num_envs, theirs.train_freq.frequency),
        "updates": (ours.gradient_steps, theirs.gradient_steps),
    }
    if algo == "td3":
        pairs["policy_delay"] = (ours.algo.policy_delay, theirs.policy_delay)
        pairs["policy_noise"] = (algorithm.loss.policy_noise, theirs.target_policy_noise)
        pairs["noise_clip"] = (algorithm.loss.noise_clip, theirs.target_noise_clip)
    if algo == "sac":
        pairs["temperature"] = (algorithm.loss.log_alpha.exp().item(), theirs.log_ent_coef.exp().item())
        pairs["entropy"] = (float(algorithm.loss.target_entropy), float(theirs.target_entropy))
        assert theirs.target_update_interval == 1
    if algo == "ddpg":  # their DDPG is TD3 with one critic, without delay and noise
        assert (theirs.policy_delay, theirs.target_noise_clip) == (1, 0.0)
    for name, (mine, other) in pairs.items():
        assert mine == pytest.approx(other), name
        if name in UNUSUAL and mine is not None:
            assert mine == pytest.approx(UNUSUAL[name] if name != "action_noise" else (UNUSUAL[name],)), name
    assert exploration.warmup == "uniform" and exploration.hold == 1
    assert not (ours.replay.mirror or ours.algo.average_policy)


@pytest.mark.parametrize("algo", ALGORITHMS)
def test_both_have_the_same_networks_and_optimisers(recipe, algo):
    _, algorithm, theirs = sides(recipe, algo)
    critic = algorithm.loss.value_network if algo == "ddpg" else algorithm.loss.qvalue_network
    params = algorithm.loss.value_network_params if algo == "ddpg" else algorithm.loss.qvalue_network_params
    # 17 numbers seen, 6 actions; a Gaussian actor has two outputs for each, which theirs makes in two layers.
    shapes = [tuple(weight.shape) for weight in weights(theirs.actor)]
    expected = [(24, 17), (12, 24), (6, 12)] + ([(6, 12)] if algo == "sac" else [])
    assert shapes == expected
    mine = [tuple(weight.shape) for weight in weights(algorithm.actor)]
    assert mine == ([*expected[:2], (12, 12)] if algo == "sac" else expected)
    assert [tuple(weight.shape) for weight in weights(theirs.critic)] == [(24, 23), (12, 24), (1, 12)] * (
        1 if algo == "ddpg" else 2
    )
    stacked = {tuple(value.shape) for value in params.values(True, True) if value.ndim >= 2 and value.shape[-1] > 2}
    lead = () if algo == "ddpg" else (2,)
    assert {(*lead, 24, 23), (*lead, 12, 24), (*lead, 1, 12)} <= stacked
    for one, other in ((algorithm.actor, theirs.actor), (critic, theirs.critic)):
        kinds = [
            {type(m) for m in module.modules() if isinstance(m, (nn.ReLU, nn.LayerNorm))} for module in (one, other)
        ]
        assert kinds == [{nn.ReLU}, {nn.ReLU}]
    # PyTorch's initial weights: uniform up to one over the root of a unit's inputs.
    for module in (algorithm.actor, theirs.actor):
        first = weights(module)[0]
        assert 0.95 < first.abs().max().item() * math.sqrt(first.shape[1]) <= 1.0
    optimisers = [
        theirs.actor.optimizer,
        theirs.critic.optimizer,
        *([theirs.ent_coef_optimizer] if algo == "sac" else []),
    ]
    for optimiser in (*algorithm.optimizers.values(), *optimisers):
        assert isinstance(optimiser, torch.optim.Adam)
        (group,) = optimiser.param_groups
        assert [group[key] for key in ("lr", "betas", "eps", "weight_decay")] == [7e-4, (0.9, 0.999), 1e-8, 0]
        assert not (group["amsgrad"] or group["maximize"])


# Statistics of curves.


def test_a_mean_has_students_interval(curves):
    # Mean 2, deviation 1; the 97.5 % quantile at two degrees of freedom is 4.303: 4.303 / sqrt(3) = 2.484.
    found = curves.mean([1.0, 2.0, 3.0])
    assert (found.value, found.low, found.high) == pytest.approx((2.0, -0.484, 4.484), abs=1e-3)
    assert curves.mean([5.0]) == curves.Mean(5.0)
    assert found.text() == "2 [-0, 4]" and curves.mean([5.0]).text() == "5"


def test_a_difference_has_welchs_interval(curves):
    # Variances 1 and 4 of three each: 1/3 + 4/3 = 5/3, whose degrees of freedom are (5/3)^2 / ((1/9 + 16/9) / 2).
    half = stats.t.ppf(0.975, (25 / 9) / (17 / 18)) * math.sqrt(5 / 3)
    found = curves.difference([1.0, 2.0, 3.0], [2.0, 4.0, 6.0])
    assert (found.value, found.low, found.high) == pytest.approx((-2.0, -2.0 - half, -2.0 + half))
    assert curves.difference([1.0], [2.0, 4.0]) == curves.Mean(-2.0)
    assert curves.difference([1.0, 1.0], [3.0, 3.0]) == curves.Mean(-2.0, -2.0, -2.0)


def run(curves, side, seed, *returns, task="walker2d", algo="td3", every=100):
    rows = [{"frames": float(every * (i + 1)), "return_mean": value} for i, value in enumerate(returns)]
    return curves.Run(task, algo, side, seed, curve=rows)


def test_a_comparison_is_of_what_all_runs_have(curves, tmp_path):
    ours = [run(curves, "gctd3", 0, 10.0, 20.0, 99.0), run(curves, "gctd3", 1, 12.0, 22.0)]
    theirs = [run(curves, "sb3", 0, 100.0, 21.0), run(curves, "sb3", 1, 102.0, 23.0)]
    assert curves.compare(ours, "walker2d", "td3") is None
    assert curves.compare([*ours, *theirs], "walker2d", "sac") is None
    found = curves.compare([*ours, *theirs], "walker2d", "td3")
    assert found.frames == [100, 200] and found.overlap == [False, True]
    assert [point.value for point in found.curves["gctd3"]] == [11.0, 21.0]
    # (11 + 21) / 2 - (101 + 22) / 2
    assert found.average.value == -45.5 and found.average.low < -45.5 < found.average.high < 0
    line = curves.table([found]).splitlines()[1]
    assert line.split()[:4] == ["walker2d", "td3", "2/2", "200"] and line.endswith("1/2")
    one = curves.compare([ours[0], theirs[0]], "walker2d", "td3")
    assert one.overlap is None and curves.table([one]).endswith("-")
    curves.draw([found, one], tmp_path / "curves.png")
    assert (tmp_path / "curves.png").read_bytes()[:4] == b"\x89PNG"


def test_published_returns_stand_beside_a_million_steps_only(curves):
    def table(every):
        runs = [run(curves, side, 0, 1.0, 2.0, every=every) for side in curves.SIDES]
        return curves.table([curves.compare(runs, "walker2d", "td3")])

    assert "published" not in table(499_999)
    assert table(500_000).endswith("at 1,000,000 steps: 4683 ± 540, 4058 ± 659, 3982 ± 275, 4718")


# The command.

SHORT = {"tasks": "walker2d", "algos": "td3", "seeds": "0", "steps": "400", "every": "100", "episodes": "1"}


@pytest.fixture
def yardsticks(tmp_path, monkeypatch):
    """Return a function that runs the benchmark with options."""
    pytest.importorskip("stable_baselines3")
    benchmark = importlib.import_module("yardsticks")

    def call(**options):
        given = {**SHORT, "random_steps": "300", "runs": tmp_path / "runs", "out": tmp_path / "out.json", **options}
        monkeypatch.setattr(sys, "argv", ["yardsticks.py", *(f"{key}={value}" for key, value in given.items())])
        benchmark.main()
        return json.loads((tmp_path / "out.json").read_text())

    call.module = benchmark
    return call


@pytest.mark.nightly
def test_trains_both_and_goes_on_where_it_stopped(yardsticks, tmp_path, monkeypatch, capsys):
    written = yardsticks(sides="gctd3")
    assert [run["side"] for run in written["runs"]] == ["gctd3"] and written["comparisons"] == []

    def never(*_):
        raise AssertionError("trained again")

    monkeypatch.setattr(yardsticks.module, "train_ours", never)
    written = yardsticks(plot=tmp_path / "curves.png")
    ours, theirs = written["runs"]
    assert (ours["side"], theirs["side"]) == ("gctd3", "sb3") and (tmp_path / "curves.png").exists()
    # Ours is not evaluated while it acts randomly; later evaluations of both come at the same steps.
    assert [row["frames"] for row in ours["curve"]] == [300, 400]
    assert [row["frames"] for row in theirs["curve"]] == [100, 200, 300, 400]
    assert [run["curve"][-1]["updates"] for run in (ours, theirs)] == [101, 99]
    (comparison,) = written["comparisons"]
    assert comparison["frames"] == [300, 400] and comparison["overlap"] is None
    assert "walker2d  td3   1/1    400" in capsys.readouterr().out
    monkeypatch.setattr(yardsticks.module, "train_theirs", never)
    assert yardsticks()["runs"] == written["runs"]
    with pytest.raises(SystemExit, match="holds runs with steps=400: choose another out="):
        yardsticks(steps=500)


def test_what_there_is_none_of_is_named(yardsticks):
    with pytest.raises(SystemExit, match="algos knows no ppo; there are td3, sac, ddpg"):
        yardsticks(algos="td3,ppo")
    with pytest.raises(SystemExit, match="every must be at most steps=400, got 401"):
        yardsticks(every=401)


def test_recipes_differ_from_the_test_values(recipe):
    """No test value equals the recipe's, so that a value that is not passed on fails the comparison above."""
    assert all(getattr(recipe.Recipe(), name) != value for name, value in UNUSUAL.items())
    assert replace(recipe.Recipe(), **UNUSUAL) == recipe.Recipe(**UNUSUAL)
