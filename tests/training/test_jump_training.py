"""A training to jump, from the warm-up to the evaluation of its policy."""

import csv
import json

import pytest
from running import command

from gctd3.tasks.jump_command import JumpCommand
from gctd3.training.evaluations import WARMUP_GAIT


@pytest.mark.nightly
def test_a_training_to_jump_is_evaluated_by_its_heights(finished, tmp_path, capsys):
    run, out = finished["jump"], tmp_path / "out"
    with (run / "progress.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert all(0.0 <= float(row["apex_error"]) < 0.5 and float(row["apex_mean"]) >= 0.0 for row in rows)
    # The fittest jumps of the warm-up are replayed without a policy.
    assert json.loads((run / WARMUP_GAIT).read_text())["apex_mean"] >= 0.0
    assert command("evaluate", f"run={run}", f"out={out}", "episodes=6", "threads=1") == 0
    report, said = json.loads((out / "evaluation.json").read_text()), capsys.readouterr().out
    assert sum(level["episodes"] for level in report["jumps"]) == 6
    assert {level["commanded"] for level in report["jumps"]} <= set(JumpCommand().levels)
    assert "apex off the commanded height, m" in said and "commanded, m" in said and "paper" not in said
