"""The comparison of ``GraphExtractor`` with an MLP: equal settings, resumption, and what is committed."""

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

pytest.importorskip("stable_baselines3")
BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def benchmark(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module("sb3_graph")


def run(benchmark, monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["sb3_graph.py", *arguments])
    benchmark.main()


def test_sides_differ_in_their_extractor_only(benchmark):
    env = benchmark.make("Hopper-v5")
    graph, mlp = (benchmark.model_of(side, "ppo", env, 0) for side in benchmark.SIDES)
    assert type(graph.policy.features_extractor).__name__ == "GraphExtractor"
    assert type(mlp.policy.features_extractor).__name__ == "CombinedExtractor"
    same = ("n_steps", "batch_size", "n_epochs", "gamma", "learning_rate", "ent_coef", "observation_space")
    assert all(getattr(graph, name) == getattr(mlp, name) for name in same)
    assert graph.policy.net_arch == mlp.policy.net_arch


@pytest.mark.nightly
def test_it_goes_on_where_it_stopped(benchmark, monkeypatch, tmp_path):
    trained = []

    def train(run, given):
        trained.append((run.side, run.seed))
        run.frames, run.returns = [10], [float(run.seed + (run.side == "graph"))]

    monkeypatch.setattr(benchmark, "train", train)
    out = f"out={tmp_path / 'out.json'}"
    run(benchmark, monkeypatch, "seeds=0", out)
    run(benchmark, monkeypatch, "seeds=0,1", out)
    assert trained == [("graph", 0), ("mlp", 0), ("graph", 1), ("mlp", 1)]
    found = json.loads((tmp_path / "out.json").read_text())["comparison"]["last evaluation"]
    assert (found["graph"]["value"], found["mlp"]["value"], found["difference"]["value"]) == (1.5, 0.5, 1.0)
    with pytest.raises(SystemExit, match="holds runs with frames=20480, every=4096: choose another out="):
        run(benchmark, monkeypatch, "frames=100", "every=10", out)


@pytest.mark.parametrize("wrong", ["algo=dqn", "sides=cnn", "every=99999999"])
def test_wrong_options_exit_before_training(benchmark, monkeypatch, wrong):
    monkeypatch.setattr(benchmark, "train", lambda *_: pytest.fail("it trained"))
    with pytest.raises(SystemExit, match=wrong.split("=")[0]):
        run(benchmark, monkeypatch, wrong)


def test_documentation_says_what_was_found():
    """The committed comparison, computed again from its runs, and its numbers in the documentation."""
    held = json.loads((BENCHMARKS / "results" / "sb3_graph.json").read_text(encoding="utf-8"))
    last = {side: [run["returns"][-1] for run in held["runs"] if run["side"] == side] for side in ("graph", "mlp")}
    assert {side: len(values) for side, values in last.items()} == {"graph": 3, "mlp": 3}
    ends = stats.ttest_ind(last["graph"], last["mlp"], equal_var=False).confidence_interval(0.95)
    said = [np.mean(last["graph"]) - np.mean(last["mlp"]), *ends]
    np.testing.assert_allclose(said, [*held["comparison"]["last evaluation"]["difference"].values()], rtol=1e-9)
    page = (BENCHMARKS.parent / "docs" / "stable-baselines3.md").read_text(encoding="utf-8")
    assert "| {:.0f} [{:.0f}, {:.0f}] |".format(*said) in page
    for side in last:
        assert "| {:.0f} [{:.0f}, {:.0f}] |".format(*held["comparison"]["last evaluation"][side].values()) in page
