"""``algo.compile=true``: compiled losses give the same updates, and a training with them ends as one without."""

import functools
import shutil

import pytest
import torch
from running import rows, train
from toy_algorithms import KINDS, build, going_on

from gctd3.algorithms.base import EAGER

UPDATES = EAGER + 4
# Warnings of PyTorch, TensorDict and TorchRL about their own code while it is traced.
pytestmark = [
    pytest.mark.filterwarnings(f"ignore::{kind}") for kind in ("DeprecationWarning", "FutureWarning", "UserWarning")
]


def updated(name, compiled):
    """Return an algorithm after a few updates, and the metrics of the last one."""
    algorithm = build(name, compile=compiled)
    for i in range(UPDATES):
        torch.manual_seed(i)
        metrics = algorithm.update(going_on())
    return algorithm, metrics


# Tracing takes long; only the losses differ between algorithms.
@pytest.mark.nightly
@pytest.mark.parametrize("name", KINDS)
def test_traced_losses_update_as_they_are(name, monkeypatch):
    """Losses that are traced for the compiler, and run without it, update bit for bit as the original ones."""
    traced, compiler = [], torch.compile

    def trace(function, mode):
        traced.append((function.__name__, mode))
        return compiler(function, backend="eager")

    monkeypatch.setattr(torch, "compile", trace)
    plain, compiled = updated(name, False), updated(name, True)
    assert traced == [(loss, "default") for loss in compiled[0].LOSSES]
    assert plain[1].keys() == compiled[1].keys()
    for key, value in plain[1].items():
        assert torch.equal(value, compiled[1][key]), key
    first, second = (algorithm.state_dict()["loss"] for algorithm in (plain[0], compiled[0]))
    fresh = build(name).state_dict()["loss"]
    assert first.keys() == second.keys() and any(not torch.equal(first[key], fresh[key]) for key in first)
    for key, value in first.items():
        assert torch.equal(value, second[key]), key


@pytest.mark.nightly
@pytest.mark.skipif(not any(map(shutil.which, ("g++", "clang++"))), reason="torch.compile needs a C++ compiler")
@pytest.mark.parametrize("name", ["gctd3", "sac"])
def test_a_compiled_training(tmp_path, name, monkeypatch):
    compiler, compiled = torch.compile, []

    @functools.wraps(compiler)
    def counted(function, **options):
        compiled.append(function.__name__)
        return compiler(function, **options)

    monkeypatch.setattr(torch, "compile", counted)
    plain = rows(train(tmp_path / "plain", f"algo={name}"))
    assert not compiled
    ours = rows(train(tmp_path / "compiled", f"algo={name}", "algo.compile=true"))
    assert compiled
    # Sums in another order differ in the last bits, and a falling robot soon amplifies that.
    assert [row["frames"] for row in ours] == [row["frames"] for row in plain]
    assert [row["updates"] for row in ours] == [row["updates"] for row in plain]
    assert float(ours[0]["return_mean"]) == pytest.approx(float(plain[0]["return_mean"]), rel=1e-2)
