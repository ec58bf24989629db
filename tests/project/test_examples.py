"""The examples run, print what they promise, and use no more of the library than they claim."""

import ast
import importlib
import math
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from running import TINY, rows
from torchrl.collectors import Collector

EXAMPLES = Path(__file__).parents[2] / "examples"
NAMES = sorted(file.stem for file in EXAMPLES.glob("*.py"))


@pytest.fixture(autouse=True)
def _examples(monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLES))


def test_there_are_five():
    assert NAMES == ["ppo_walker", "sac_gymnasium", "sb3_gymnasium", "transfer", "tune"]


@pytest.mark.parametrize("name", NAMES)
def test_is_short_and_imports_graphs_nodes_and_networks_only(name):
    text = (EXAMPLES / f"{name}.py").read_text(encoding="utf-8")
    assert text.count("\n") < 120
    imported = [node.module for node in ast.walk(ast.parse(text)) if isinstance(node, ast.ImportFrom)]
    assert {module for module in imported if module.startswith("gctd3")} <= {
        "gctd3",
        "gctd3.nn",
        "gctd3.envs.nodes",
        "gctd3.sb3",
    }


@pytest.mark.parametrize("name", NAMES)
def test_help(name, capsys):
    if name == "tune":
        pytest.importorskip("optuna", minversion="4")
    if name == "sb3_gymnasium":
        pytest.importorskip("stable_baselines3")
    module = importlib.import_module(name)
    with pytest.raises(SystemExit) as end:
        module.main(["--help"])
    assert end.value.code == 0
    said = capsys.readouterr().out
    assert module.__doc__.splitlines()[0] in said and "--frames" in said and "--seed" in said


def test_tune_names_the_package_that_it_needs():
    code = "import runpy, sys; sys.modules['optuna'] = None; runpy.run_path('tune.py', run_name='__main__')"
    said = subprocess.run([sys.executable, "-c", code], cwd=EXAMPLES, capture_output=True, text=True)
    assert said.returncode == 1 and said.stderr == "error: examples/tune.py needs optuna: pip install 'optuna>=4'\n"


def test_ppo(capsys):
    main = importlib.import_module("ppo_walker").main
    few = ["--frames", "64", "--batch", "32", "--minibatch", "16", "--epochs", "2"]
    learnt, said = main(few), capsys.readouterr().out
    still, said_still = main([*few, "--learning-rate", "0"]), capsys.readouterr().out
    assert "right_hip" in said
    (first, last), (first_still, _) = (
        [line for line in text.splitlines() if " steps  reward" in line] for text in (said, said_still)
    )
    assert f"64 steps  reward a step {learnt:.3f}" in last
    # The same seed: until the first update they act alike, then only the one whose weights may change has changed.
    assert first == first_still and learnt != still and math.isfinite(learnt)


@pytest.mark.nightly
def test_sac():
    few = ["--frames", "200", "--warmup", "100", "--batch", "16"]
    returns = importlib.import_module("sac_gymnasium").main(["--env", "Walker2d-v5", *few])
    assert returns and all(map(math.isfinite, returns))


@pytest.mark.parametrize(
    "algo", ["td3", pytest.param("sac", marks=pytest.mark.nightly), pytest.param("ppo", marks=pytest.mark.nightly)]
)
def test_stable_baselines3(algo, tmp_path, capsys):
    baselines = pytest.importorskip("stable_baselines3")
    few = ["--algo", algo, "--env", "Hopper-v5", "--frames", "110", "--save", str(tmp_path / "model")]
    assert math.isfinite(importlib.import_module("sb3_gymnasium").main(few))
    assert "Hopper-v5" in capsys.readouterr().out
    saved = getattr(baselines, algo.upper()).load(tmp_path / "model", device="cpu")
    assert saved.num_timesteps >= 110 and type(saved.policy).__name__.startswith(("MultiInput", "TD3", "SAC"))


@pytest.mark.nightly
def test_transfer(tmp_path, monkeypatch):
    begun = []

    class Watched(Collector):
        """Record the weights with which a training begins, and how long it acts without them."""

        def __init__(self, env, policy, *, init_random_frames, **settings):
            weights = {name: value.clone() for name, value in policy.state_dict().items()}
            begun.append((weights, init_random_frames))
            super().__init__(env, policy, init_random_frames=init_random_frames, **settings)

    monkeypatch.setattr(importlib.import_module("sac_gymnasium"), "Collector", Watched)
    few = ["--frames", "100", "--warmup", "80", "--batch", "8", "--save", str(tmp_path / "weights.pt")]
    result = importlib.import_module("transfer").main(["--source", "Walker2d-v5", "--target", "Hopper-v5", *few])
    assert set(result) == {"transferred", "scratch"} and all(map(math.isfinite, result.values()))
    # The source's end is the beginning of the one, who acts on it at once, and not of the other.
    trained = torch.load(tmp_path / "weights.pt", weights_only=True)
    (source, _), (transferred, random), (scratch, random_scratch) = begun
    torch.testing.assert_close(transferred, trained, rtol=0, atol=0)
    assert (random, random_scratch) == (0, 80)
    for other in (source, scratch):
        assert any(not torch.equal(other[name], value) for name, value in trained.items())


@pytest.mark.nightly
def test_tune_goes_on_where_it_stopped(tmp_path):
    pytest.importorskip("optuna", minversion="4")
    settings = [f"{key}={value}" for key, value in TINY.items() if key not in ("total_frames", "gradient_steps")]
    few = ["--frames", "240", "--out", str(tmp_path / "out"), *settings]
    tune = importlib.import_module("tune").main
    first = tune(["--trials", "1", *few])
    assert tune(["--trials", "2", *few]) >= first
    assert {run.name for run in (tmp_path / "out").glob("trial?")} == {"trial0", "trial1"}
    best = max(float(row["return_mean"]) for run in (tmp_path / "out").glob("trial?") for row in rows(run))
    assert tune(["--trials", "2", *few]) == best
