"""A policy that would end the training has to meet the conditions from other starts too, and is then kept."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from made_up_runs import make
from running import Recorded, rows, train

from gctd3.comparison.runs import find_runs
from gctd3.errors import ConfigError
from gctd3.evaluation import rollout
from gctd3.runs.evaluate import measure_run
from gctd3.runs.load import load_run
from gctd3.runs.settings import EvaluateSettings
from gctd3.training import confirmation, evaluations
from gctd3.training.checkpoint import Checkpoints
from gctd3.training.stop_when import StopWhen

# Conditions that every policy meets.
EASY = ["~stop_when.at_most", "~stop_when.at_least.stride_hz", "stop_when.at_least.success_rate=0"]
EASY += ["stop_when.at_least.return_mean=-1000", "stop_when.at_least.velocity_mean=-10", "total_frames=320"]


def test_confirm_is_a_number_of_episodes():
    with pytest.raises(ConfigError, match=r"confirm must be at least 0 .* got -1"):
        StopWhen(confirm=-1)
    assert StopWhen(evaluations=2).ends_after(2) and not StopWhen(evaluations=2).ends_after(1)
    assert not StopWhen(evaluations=None, confirm=5).ends_after(100)


def test_a_policy_with_commands_is_described_by_them():
    errors = {f"error_{axis}": 0.1 for axis in ("forward", "side", "turn")}
    metrics = {"return_mean": 1200.0, **errors, "followed_rate": 0.96, "fall_rate": 0.02}
    said = confirmation.described(metrics, 50, False)
    assert "From 50 other starts this policy misses the conditions that it met: return 1200, 96% of the" in said
    assert "falls 2%" in said and "success" not in said


def test_a_confirmed_policy_ends_the_training_at_once(tmp_path, capsys, monkeypatch):
    seen = []
    evaluate = rollout.evaluate

    def watched(policy, env, task, seed, *more, **named):
        result = evaluate(policy, env, task, seed, *more, **named)
        # The first heights of an episode differ with its start.
        seen.append((seed, len(result.episodes), [episode.height[0] for episode in result.episodes]))
        return result

    monkeypatch.setattr(confirmation, "evaluate", watched)
    run = train(tmp_path / "run", *EASY, "stop_when.confirm=3")
    assert [(row["frames"], row["confirmed"]) for row in rows(run)] == [("80", "1.0")]
    (reported,) = find_runs(run)
    assert reported.trouble is None
    assert "From 3 other starts this policy meets the conditions too" in capsys.readouterr().out
    # The warm-up's gait is measured before the policy, with the same seed of the starts.
    gait, (seed, episodes, starts), (other, confirming, more) = seen
    assert (seed, episodes, other, confirming) == (1_000, 2, 1_001, 3)
    assert gait[:2] == (seed, episodes)
    assert not np.isin(more, starts).any()


def test_a_policy_that_is_not_confirmed_trains_on_and_a_confirmed_one_is_the_best(tmp_path, monkeypatch, capsys):
    again = [{"return_mean": -2000.0, "success_rate": 0.0, "velocity_mean": 0.0}, None]

    def confirm(policy, settings, task):
        verdict, again[0] = again[0], again[1]
        return verdict or {"return_mean": 0.0, "success_rate": 0.0, "velocity_mean": 0.0}

    monkeypatch.setattr(evaluations, "confirm", confirm)
    run = train(tmp_path / "run", *EASY, "stop_when.confirm=3")
    assert [(row["frames"], row["confirmed"]) for row in rows(run)] == [("80", "0.0"), ("160", "1.0")]
    assert Checkpoints(run).best().name == "best-000000000160" and Recorded.last.finished
    said = capsys.readouterr().out
    assert said.index("misses the conditions that it met") < said.index("meets the conditions too")


def test_conditions_on_a_motion_are_measured_from_other_starts_too():
    run = load_run(str(Path(__file__).parents[2] / "models" / "biped" / "policy"))
    rule = StopWhen(at_least={"success_rate": 1.0, "periodic_fraction": 1.0}, at_most={"slip_speed": 0.3}, confirm=2)
    settings = replace(run.settings, stop_when=rule)
    seen = confirmation.confirm(run.policy(), settings, run.setup.task)
    assert rule.all_reached(seen), seen
    # The same as the command's evaluation of so many episodes from these starts.
    given = {"run": str(run.directory), "episodes": 2, "seed": settings.evaluation.seed + 1, "threads": 1}
    report = measure_run(EvaluateSettings(**given)).report
    for name in ("return_mean", "distance_mean"):
        assert seen[name] == pytest.approx(report[name])
    for name in ("periodic_fraction", "slip_speed", "height_from_home", "torque_saturation"):
        assert seen[name] == pytest.approx(report["gait"][name])


@pytest.mark.parametrize(
    "evaluations, confirmed, ended",
    [
        (1, ("", "1.0"), True),
        (1, ("", "0.0"), False),
        (2, ("", "1.0"), True),
        # The second evaluation in a row that met the conditions was to be confirmed, and the next one is a first again.
        (2, ("0.0", ""), False),
        # Of before there was the column.
        (2, None, True),
    ],
)
def test_a_run_that_stopped_unconfirmed_is_told_from_one_that_ended(tmp_path, evaluations, confirmed, ended):
    """All of them met the conditions at their last evaluations."""
    run = make(tmp_path, "seed0")
    file = run / ".hydra" / "config.yaml"
    rule = {"at_least": {"return_mean": 1.0}, "at_most": {}, "evaluations": evaluations, "confirm": 50}
    file.write_text(json.dumps({**json.loads(file.read_text()), "total_frames": 9000, "stop_when": rule}))
    if confirmed is not None:
        table = (run / "progress.csv").read_text().splitlines()
        cells = ("confirmed", *confirmed)
        (run / "progress.csv").write_text("".join(f"{row},{cell}\n" for row, cell in zip(table, cells, strict=True)))
    (found,) = find_runs(tmp_path)
    assert found.trouble == (None if ended else "stopped at 2,000 of 9,000 frames")


@pytest.mark.nightly
def test_confirming_changes_nothing_of_the_training(tmp_path, monkeypatch):
    real = confirmation.confirm

    def never(*arguments):
        # As many episodes as without a test, of which the training must not notice anything.
        return {**real(*arguments), "return_mean": -2000.0}

    plain = train(tmp_path / "plain", *EASY, "stop_when.evaluations=null")
    weights = Recorded.last.algorithm.actor.state_dict()
    monkeypatch.setattr(evaluations, "confirm", never)
    other = train(tmp_path / "other", *EASY, "stop_when.confirm=2")
    drop = ("wall_s", "confirmed")
    assert rows(plain, drop) == rows(other, drop)
    assert all(torch.equal(value, weights[name]) for name, value in Recorded.last.algorithm.actor.state_dict().items())
