"""A report refuses runs of different tasks or evaluations and repeated seeds, and notes unequal trainings."""

import csv
import json
import re
import shutil

import pytest
from made_up_runs import make
from running import command

pytest.importorskip("matplotlib")

from gctd3.comparison.comparability import check_episodes, check_seeds, check_together
from gctd3.comparison.groups import groups_of
from gctd3.comparison.report import report
from gctd3.comparison.runs import find_runs
from gctd3.comparison.settings import ReportSettings
from gctd3.comparison.tables import table5
from gctd3.comparison.verdict import verdict
from gctd3.errors import RunError
from gctd3.evaluation.settings import EpisodeSettings

TD3 = {"overrides": ["algo=td3"], "change": {"algo.tau": 0.01}}


@pytest.mark.parametrize(
    "change, said",
    [
        ({"robot.name": "quadruped"}, "robot, robot.name: biped in a0; quadruped in b0"),
        (
            {"evaluation.reward.terms.fall.weight": -5.0},
            "evaluation reward, evaluation.reward.terms.fall.weight: -10.0 in a0; -5.0 in b0",
        ),
        (
            {"task.terminations.fall.height": -0.2},
            "terminations, task.terminations.fall.height: -0.1 in a0; -0.2 in b0",
        ),
        ({"task.control_dt": 0.04}, "task, task.control_dt: 0.02 in a0; 0.04 in b0"),
    ],
)
def test_runs_that_do_not_belong_together_are_refused(tmp_path, change, said):
    make(tmp_path, "a0")
    make(tmp_path, "b0", change=change)
    with pytest.raises(RunError, match=re.escape(said)):
        check_together(find_runs(tmp_path))


# Equal evaluations.


def evaluate_over(run, episodes, seed):
    """Write into a made-up run over which episodes it was evaluated."""
    file = run / "evaluation.json"
    content = {**json.loads(file.read_text()), "episodes": episodes, "seeds": {"training": 0, "evaluation": seed}}
    file.write_text(json.dumps(content))
    return run


def test_runs_evaluated_over_other_episodes_are_refused(tmp_path):
    for name in ("a0", "a1", "a2"):
        evaluate_over(make(tmp_path, name), 50, 10_000)
    check_episodes(find_runs(tmp_path), EpisodeSettings())
    # The report's own settings do not matter if all runs are evaluated.
    check_episodes(find_runs(tmp_path), EpisodeSettings(episodes=3, seed=4))
    evaluate_over(tmp_path / "a2", 1, 7)
    with pytest.raises(RunError) as error:
        check_episodes(find_runs(tmp_path), EpisodeSettings())
    said = str(error.value)
    assert "50 episodes from starts of seed 10000: a0, a1" in said and "1 episode from starts of seed 7: a2" in said
    assert said.endswith(f"python -m gctd3.evaluate run={tmp_path / 'a2'} episodes=50 seed=10000")


def test_the_same_number_from_other_starts_is_refused_too(tmp_path):
    evaluate_over(make(tmp_path, "a0"), 50, 1)
    evaluate_over(make(tmp_path, "a1"), 50, 2)
    with pytest.raises(RunError, match="from starts of seed 2: a1"):
        check_episodes(find_runs(tmp_path), EpisodeSettings())


def test_what_does_not_say_how_it_was_evaluated_goes_with_its_like_only(tmp_path):
    make(tmp_path, "a0")
    make(tmp_path, "a1")
    check_episodes(find_runs(tmp_path), EpisodeSettings())
    evaluate_over(make(tmp_path, "a2"), 20, 5)
    with pytest.raises(RunError, match="an unknown number of episodes from starts of an unknown seed: a0, a1") as error:
        check_episodes(find_runs(tmp_path), EpisodeSettings())
    assert f"run={tmp_path / 'a1'} episodes=20 seed=5" in str(error.value)


@pytest.mark.nightly
def test_what_is_evaluated_now_has_to_be_evaluated_as_the_rest_was(finished, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for seed, name in enumerate(["gctd3", "gctd3 seed 1"]):
        finished.copy(name, tmp_path / "runs" / str(seed))
    assert command("evaluate", "run=runs/0", "episodes=2", "seed=5", "threads=1") == 0
    # It has no policy, so nothing will evaluate it.
    make(tmp_path / "runs", "a2", evaluation=False)
    shutil.copy(tmp_path / "runs" / "0" / ".hydra" / "config.yaml", tmp_path / "runs" / "a2" / ".hydra")
    config = tmp_path / "runs" / "a2" / ".hydra" / "config.yaml"
    config.write_text(config.read_text().replace("\nseed: 0\n", "\nseed: 2\n"))
    capsys.readouterr()
    assert command("report", "runs=runs", "out=out") == 2
    said = capsys.readouterr().err
    assert "not yet evaluated, now to be over 50 episodes from starts of seed 10000: 1\n" in said
    assert "the report's own command with episodes=2 seed=5" in said
    assert not (tmp_path / "runs" / "1" / "evaluation.json").exists() and not (tmp_path / "out").exists()
    assert command("report", "runs=runs", "out=out", "episodes=2", "seed=5", "threads=1") == 0
    with (tmp_path / "out" / "tables" / "table5.csv").open(encoding="utf-8") as file:
        row = next(csv.DictReader(file))
    assert (row["seeds evaluated"], row["seeds evaluated, of"]) == ("2", "3")
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert "each the mean of its 2 episodes; IQM" in page
    # The command in the message helps.
    assert command("evaluate", "run=runs/1", "episodes=1", "seed=5", "threads=1") == 0
    capsys.readouterr()
    assert command("report", "runs=runs", "out=out", "episodes=2", "seed=5") == 2
    remedy = re.search(r"python -m gctd3\.evaluate (run=\S+ episodes=\d+ seed=\d+)", capsys.readouterr().err)[1]
    assert command("evaluate", *remedy.split(), "threads=1") == 0
    check_episodes(find_runs(tmp_path / "runs"), EpisodeSettings(episodes=2, seed=5))


def test_table5_says_over_how_many_episodes(tmp_path, robot):
    assert "each the mean of its episodes; IQM" in table5(groups_of(find_runs(make(tmp_path, "a0"))), robot, True).note
    evaluate_over(tmp_path / "a0", 30, 1)
    assert "the mean of its 30 episodes; IQM" in table5(groups_of(find_runs(tmp_path)), robot, True).note


# Each seed once.


def test_a_seed_counts_once(tmp_path):
    for seed in (0, 1):
        make(tmp_path / "runs", f"a{seed}")
        make(tmp_path / "runs", f"b{seed}", **TD3)
    check_seeds(groups_of(find_runs(tmp_path / "runs")))
    shutil.copytree(tmp_path / "runs" / "b1", tmp_path / "runs" / "copies" / "b1")
    both = f"td3, seed 1: {tmp_path / 'runs' / 'b1'} and {tmp_path / 'runs' / 'copies' / 'b1'}"
    with pytest.raises(RunError, match=re.escape(both)):
        report(ReportSettings(str(tmp_path / "runs"), str(tmp_path / "out")))
    assert not (tmp_path / "out").exists()


def test_other_random_graphs_are_other_seeds(tmp_path):
    for name, graph in (("0", 0), ("1", 1)):
        make(tmp_path / name, "a0", change={"robot.graph": "random", "robot.graph_seed": graph})
    check_seeds(groups_of(find_runs(tmp_path)))
    # The seed of random graphs has no effect on the kinematic tree.
    for name, graph in (("2", 0), ("3", 1)):
        make(tmp_path / name, "a0", change={"robot.graph_seed": graph})
    with pytest.raises(RunError, match="graph=tree, seed 0: "):
        check_seeds(groups_of(find_runs(tmp_path)))


# Equal trainings.


def trained(root, name, frames, updates, **settings):
    run = make(root, name, **settings)
    (run / "progress.csv").write_text(f"frames,updates,wall_s,return_mean\n{frames},{updates},60,500\n")


def lengths(root):
    return [line for line in verdict(groups_of(find_runs(root))) if line.startswith("Trainings were not")]


def test_unequal_trainings_are_said_with_their_numbers(tmp_path):
    for seed, frames in enumerate([60_032, 99_968]):
        trained(tmp_path, f"a{seed}", frames, frames // 16)
        trained(tmp_path, f"b{seed}", 99_968, 6_248, **TD3)
    assert lengths(tmp_path) == [
        "Trainings were not equally long, and are compared all the same: gctd3 60,032 to 99,968 frames and 3,752 to "
        "6,248 updates; td3 99,968 frames and 6,248 updates."
    ]


@pytest.mark.parametrize("frames, updates, said", [(99_968, 6_248, 0), (100_000, 6_250, 0), (99_968, 3_124, 1)])
def test_updates_count_and_the_last_batch_does_not(tmp_path, frames, updates, said):
    trained(tmp_path, "a0", 99_968, 6_248)
    trained(tmp_path, "b0", frames, updates, **TD3)
    assert len(lengths(tmp_path)) == said


def test_one_group_is_compared_with_nothing(tmp_path):
    trained(tmp_path, "a0", 40_000, 2_000)
    trained(tmp_path, "a1", 90_000, 5_000)
    assert lengths(tmp_path) == []
