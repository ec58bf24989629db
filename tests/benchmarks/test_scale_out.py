"""The benchmark of workers: its arithmetic by hand, and a small run of it."""

import importlib
import json
import math
import sys
from pathlib import Path

import pytest
from running import TINY


@pytest.fixture
def scale_out(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))
    return importlib.import_module("scale_out")


def test_sizing_is_arithmetic_on_what_was_measured(scale_out):
    # Two workers collect 2,000 steps/s together; 1 update for 16 steps; 256 steps in a batch of both.
    two = scale_out.Rates(2, 2000.0, 100.0, 1500.0, 93.75, 1 / 16, 256, 400_000, 1000.0)
    inline = scale_out.Rates(0, 3000.0, 110.0, 900.0, 56.25, 1 / 16, 64, 400_000, 1000.0)
    # 100 updates/s suffice for 1,600 steps/s: fewer than are collected.
    assert two.learner_limit == 1600.0 and two.limit == "learner"
    # A measurement with more workers than cores is not extrapolated.
    crowded = scale_out.Rates(8, 1600.0, 100.0, 1200.0, 75.0, 1 / 16, 256, 400_000, 1000.0)
    each, _, ten, hundred, thousand, last = scale_out.sizing([inline, crowded, two])
    assert each == "A worker collects 1,000 steps/s; the learner does 110 updates/s."
    # 9 workers: 9,000 steps/s, and so at most 110 / 9,000 updates a step. A message of one worker has 128 steps:
    # 70.3 messages/s of 0.4 MB each.
    assert ten.split() == ["10", "9,000", "0.0122", "28.1", "9.0"]
    assert hundred.split() == ["100", "99,000", "0.0011", "309.4", "99.0"]
    assert thousand.split()[:2] == ["1000", "999,000"]
    # 110 updates/s at 1/16 a step: 1,760 steps/s.
    assert last == "With 0.0625 updates a step, as measured, the learner is the limit from 1.8 workers on."
    with pytest.raises(SystemExit, match="with workers"):
        scale_out.sizing([inline])


def test_a_rate_leaves_the_first_call_out(scale_out, monkeypatch):
    now = iter([0.0, 0.0, 2.0, 4.0])
    monkeypatch.setattr(scale_out.time, "perf_counter", lambda: next(now))
    calls = []
    assert scale_out.per_second(lambda: calls.append(None) or 10.0, 3.0) == 20.0 / 4.0
    assert len(calls) == 3


@pytest.mark.nightly
def test_a_small_run_measures_and_is_sized_again_from_its_file(scale_out, tmp_path, monkeypatch, capsys):
    few = {
        key: TINY[key]
        for key in ("env.num_envs", "threads", "replay.batch_size", "replay.buffer_size", "network.hidden")
    }
    few["gradient_steps"] = 4
    more = "more=" + " ".join(f"{key}={value}" for key, value in few.items())
    file = tmp_path / "scale_out.json"
    monkeypatch.setattr(sys, "argv", ["scale_out.py", "workers=1", "seconds=0.3", "rounds=1", f"out={file}", more])
    scale_out.main()
    inline, one = json.loads(file.read_text())["rates"]
    assert (inline["workers"], one["workers"]) == (0, 1)
    for rates in (inline, one):
        assert all(
            math.isfinite(rates[name]) and rates[name] > 0 for name in ("collected", "learnt", "steps", "updates")
        )
        # 4 updates a step of all 4 robots.
        assert rates["ratio"] == 1.0 and rates["updates"] == pytest.approx(rates["steps"])
        # Observations before and after: two stacks of 8 nodes, 2 features and 5 frames in single precision, at least.
        assert 2 * 8 * 2 * 5 * 4 < rates["step_bytes"] < 4000
    # The paper's graph layers on 8 nodes (10 -> 32 -> 32 -> 16), two layers of 16 units, 6 actions.
    weights = 10 * 32 + 32 + 32 * 32 + 32 + 32 * 16 + 16 + 8 * 16 * 16 + 16 + 16 * 16 + 16 + 16 * 6 + 6
    # Besides them a few of the normalisation, and the graph's constants.
    assert weights * 4 <= one["weight_bytes"] <= 1.1 * weights * 4
    printed = capsys.readouterr().out
    monkeypatch.setattr(sys, "argv", ["scale_out.py", f"sizing={file}"])
    scale_out.main()
    assert capsys.readouterr().out.strip() in printed
