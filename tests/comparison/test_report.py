"""The report: on hand-made runs with known answers, and from tiny trainings to the page."""

import csv
import io
import json
import re
import xml.etree.ElementTree as ElementTree
from itertools import combinations

import pytest
from made_up_runs import examined, make
from running import command

from gctd3.errors import RunError

pytest.importorskip("matplotlib")
from gctd3.comparison.comparability import check_together
from gctd3.comparison.equal_time import time_limit
from gctd3.comparison.figures import inline
from gctd3.comparison.groups import differences, groups_of
from gctd3.comparison.report import report
from gctd3.comparison.runs import find_runs
from gctd3.comparison.settings import ReportSettings
from gctd3.comparison.tables import comparisons_table, robustness_table, runs_table, spawn_height, table5
from gctd3.comparison.verdict import compare, comparisons, too_few, verdict

# Words.


def say(a, b):
    return compare("return", "", 1, "returns more", ("gctd3", a), ("td3", b)).text


def test_the_verdict_claims_no_more_than_the_intervals():
    apart = [10.0, 11.0, 12.0, 13.0, 14.0], [1.0, 2.0, 3.0, 4.0, 5.0]
    assert "return: gctd3 returns more: 12.0" in say(*apart) and "probability 1.00" in say(*apart)
    assert "return: td3 returns more" in say(*reversed(apart))
    assert "no difference shown, the intervals overlap" in say([1.0, 9.0, 3.0, 7.0, 5.0], [2.0, 8.0, 4.0, 6.0, 5.0])
    assert "a single seed cannot show one: 9.0 (1 seed) against 1.0 (1 seed)" in say([9.0], [1.0])
    assert "td3 has no number for it" in say([9.0, 8.0], [])
    assert "no difference shown, so few seeds cannot show one: 8.0" in say([7.0, 8.0, 9.0], [1.0, 2.0, 3.0])


@pytest.mark.parametrize("ours, theirs", [(2, 2), (3, 3), (3, 5), (4, 4), (1, 9)])
def test_how_many_seeds_it_takes_is_what_shuffling_them_says(ours, theirs):
    # All ways to deal the ranks 0, 1, ... to two groups alike; count those with one group wholly above the other.
    every = range(ours + theirs)
    dealt = [set(hand) for hand in combinations(every, ours)]
    apart = [h for h in dealt if max(h) < min(set(every) - h) or min(h) > max(set(every) - h)]
    assert too_few(ours, theirs) == (len(apart) / len(dealt) > 0.05)


# Runs that are made up.


@pytest.fixture
def pair(tmp_path):
    """Make two algorithms with three seeds each."""
    for seed in range(3):
        make(tmp_path, f"a{seed}", 500.0 + seed)
        make(tmp_path, f"b{seed}", 400.0 + seed, overrides=["algo=td3"], change={"algo.tau": 0.01})
    return tmp_path


def test_seeds_fall_into_groups(pair):
    groups = groups_of(find_runs(pair))
    seeds = {group: [run.seed for run in runs] for group, runs in groups.items()}
    assert seeds == {
        "gctd3": [0, 1, 2],
        "td3": [0, 1, 2],
    }
    assert differences([runs[0] for runs in groups.values()]) == {"algo.tau": [0.005, 0.01]}


def test_groups_of_one_algorithm_are_told_apart_by_what_differs(tmp_path):
    make(tmp_path, "a0")
    make(tmp_path, "b0", change={"robot.graph": "edgeless"})
    make(tmp_path, "c0", overrides=["network=per_joint"], change={"algo.tau": 0.1})
    assert set(groups_of(find_runs(tmp_path))) == {"gctd3 graph=tree", "gctd3 graph=edgeless", "gctd3 per_joint"}


def test_options_name_groups_before_values_do(tmp_path):
    make(tmp_path, "a0", overrides=["experiment=table5"])
    make(tmp_path, "b0", overrides=["experiment=table5_best"], change={"algo.tau": 0.1})
    make(tmp_path, "c0", overrides=["experiment=table5_best"], change={"algo.tau": 0.2})
    make(tmp_path, "d0", overrides=["experiment=table5", "algo=td3"], change={"algo.tau": 0.3})
    assert list(groups_of(find_runs(tmp_path))) == [
        "gctd3 table5",
        "gctd3 table5_best tau=0.1",
        "gctd3 table5_best tau=0.2",
        "td3",
    ]


def test_seeds_of_random_graphs_are_seeds(tmp_path):
    for seed in range(2):
        make(tmp_path, f"a{seed}", change={"robot.graph": "random", "robot.graph_seed": seed})
    groups = groups_of(find_runs(tmp_path))
    assert {group: len(runs) for group, runs in groups.items()} == {"gctd3": 2}


def test_table5_by_hand(pair, robot):
    table = table5(groups_of(find_runs(pair)), robot, True)
    ours, paper = dict(zip(table.head, table.rows[0], strict=True)), table.rows[1]
    assert ours["return, mean ± sd"] == "501.0 ± 1.0" and ours["return, IQM"].startswith("501.0 [")
    assert ours["seeds evaluated"] == "3 of 3" and ours["success"] == "1.00"
    # The robot is dropped 0.0235 m above where it stands.
    assert spawn_height(robot) == pytest.approx(0.0235)
    assert ours["body from standing, m"] == "0.0100" and ours["body from spawn, m"] == "-0.0135"
    assert paper[0] == "paper, GCTD3" and "380.0 ± 18.47" in paper and "1.414" in paper and "-0.0202" in paper


def test_failed_seeds_are_counted(tmp_path, capsys):
    for seed in range(2):
        make(tmp_path / "runs", f"a{seed}")
    make(tmp_path / "runs", "a2", evaluation=False)  # it has no policy either
    page = report(ReportSettings(str(tmp_path / "runs"), str(tmp_path / "out")))
    text = page.read_text(encoding="utf-8")
    assert (
        "2 of 3 seeds reach the finish in every episode that was evaluated; 1 failed and have no numbers; a whole"
        in text
    )
    assert "2 of 3" in text and "failed: " in text


@pytest.mark.nightly
def test_robustness_of_made_up_runs(pair, tmp_path):
    for seed, success in enumerate([0.5, 0.7, 0.9]):
        examined(pair / f"a{seed}", success, [2.0, 4.0], (4.0, 2.0 + seed))
    groups = groups_of(find_runs(pair))
    results = {"gctd3": [run.robustness for run in groups["gctd3"]], "td3": []}
    rows = {row[0]: row[2:] for row in robustness_table(results).rows}
    assert rows["success, mass +20 %"] == ["0.70 (0.50 to 0.90)", "-"]
    # The weakest phases are 2, 3 and 4 N s; backward one phase is unknown in all.
    assert rows["push forward, worst moment"] == ["3.0 (2.0 to 4.0)", "-"]
    assert rows["push backward, worst moment"] == ["-", "-"]
    page = report(ReportSettings(str(pair), str(tmp_path / "out")))
    text = page.read_text(encoding="utf-8")
    assert 'id="robustness"' in text and (tmp_path / "out" / "tables" / "robustness.csv").is_file()
    assert {"conditions", "pushes"} <= {file.stem for file in (tmp_path / "out" / "figures").glob("*.svg")}
    examined(pair / "a1", 0.5, [3.0, 4.0])
    with pytest.raises(RunError, match=r"the perturbations of robustness\.json"):
        check_together(find_runs(pair))
    (pair / "a1" / "robustness.json").write_text("{}")
    with pytest.raises(RunError, match="lacks conditions"):
        find_runs(pair)


@pytest.mark.nightly
def test_what_there_is_no_trace_and_no_policy_for_is_said(pair, tmp_path):
    text = report(ReportSettings(str(pair), str(tmp_path / "out"))).read_text(encoding="utf-8")
    assert "gctd3: no filmstrip. " in text and "gctd3: no joint traces and no contacts" in text
    assert "trace.csv; evaluate them again" in text


def test_the_verdict_of_made_up_runs(pair):
    said = verdict(groups_of(find_runs(pair)))
    # Return, velocity, time to the finish; return and success at equal wall-clock.
    assert said[0] == "In short: no difference shown in 5 comparisons."
    said = "\n".join(said)
    assert "gctd3 and td3, return: no difference shown, so few seeds cannot show one: 501.0" in said
    assert "fewer than 5 seeds" in said
    for seed in (3, 4):
        make(pair, f"a{seed}", 500.0 + seed)
        make(pair, f"b{seed}", 400.0 + seed, overrides=["algo=td3"], change={"algo.tau": 0.01})
    said = verdict(groups_of(find_runs(pair)))
    assert said[0] == (
        "In short: 5 comparisons, 2 of which show a difference; one in so many may be chance: gctd3 returns more than "
        "td3 (return); gctd3 returns more than td3 (return after 2.0 min of training)."
    )
    said = "\n".join(said)
    assert "gctd3 and td3, return: gctd3 returns more: 502.0" in said and "fewer than" not in said
    assert "gctd3 and td3, velocity: no difference shown, the intervals overlap" in said


def test_the_table_of_made_up_comparisons(pair):
    """Three seeds each: 500, 501, 502 against 400, 401, 402; with so few the interquartile mean is the mean."""
    groups = groups_of(find_runs(pair))
    table = comparisons_table(comparisons(groups, time_limit(groups)))
    # Return, velocity, time to the finish; return and success at equal wall-clock.
    assert len(table.rows) == 5
    row = dict(zip(table.head, table.rows[0], strict=True))
    assert row[""] == "return" and row["what it is"] == "gctd3 against td3"
    assert row["difference"] == "+100.0 (501.0 against 401.0)"
    assert row["95 % intervals"] == "[500.0, 502.0]; [400.0, 402.0]"
    assert row["probability of more"] == "1.00 [1.00, 1.00]"
    assert row["verdict"] == "no difference shown, so few seeds cannot show one"
    written = next(csv.DictReader(io.StringIO(table.csv())))
    numbers = {"difference": 100.0, "difference, first": 501.0, "difference, second": 401.0}
    numbers |= {"95 % intervals, first low": 500.0, "95 % intervals, second high": 402.0, "probability of more": 1.0}
    assert {name: float(written[name]) for name in numbers} == numbers


def test_what_cannot_be_compared_has_a_row_too(pair):
    for seed in range(3):
        file = pair / f"b{seed}" / "evaluation.json"
        file.write_text(json.dumps({**json.loads(file.read_text()), "velocity_mean": None}))
    groups = groups_of(find_runs(pair))
    rows = {row[0]: row for row in comparisons_table(comparisons(groups, None)).rows}
    assert rows["velocity"][1:6] == ["", "-", "-", "-", "cannot be compared, td3 has no number for it"]


def test_times_of_seeds_that_never_finished_are_not_compared(pair):
    (pair / "b1" / "progress.csv").write_text("frames,wall_s,return_mean,success_rate\n1000,60,5.0,0.9\n")
    said = "\n".join(verdict(groups_of(find_runs(pair))))
    assert "time to the first evaluation" not in said
    assert "between groups that always got there; not so 1 of 3 seeds of td3." in said


def test_minutes_of_made_up_runs(pair):
    row = runs_table(groups_of(find_runs(pair))).rows[0]
    assert row[:7] == ["gctd3", "0", "2.0", "2.0", "2,000", "500.0", "1.00"]


# Wrong calls.


def test_wrong_calls_are_answered(tmp_path, capsys):
    def answer(*arguments):
        assert command("report", *arguments) == 2
        return capsys.readouterr().err

    assert "No directory at" in answer(f"runs={tmp_path / 'nowhere'}")
    assert "No runs below" in answer(f"runs={tmp_path}")
    assert "episodes must be at least 1" in answer(f"runs={tmp_path}", "episodes=0")
    assert "Did you mean 'runs'?" in answer(f"run={tmp_path}")
    run = make(tmp_path, "a0")
    (run / "evaluation.json").write_text("{")
    assert "delete it to have the run evaluated again" in answer(f"runs={tmp_path}")
    (run / "evaluation.json").unlink()
    assert "None of the 1 runs" in answer(f"runs={tmp_path}")


# The page.


def test_inline_figures_take_the_pages_colour_and_have_ids_of_their_own():
    svg = (
        '<?xml version="1.0"?><svg width="9pt" viewBox="0 0 1 2" xmlns:xlink="x"><metadata>when</metadata>'
        '<path id="p" style="fill: #010203" clip-path="url(#c)"/><use xlink:href="#p"/></svg>'
    )
    found = inline(svg, "fig", "A & B")
    assert found.startswith('<svg viewBox="0 0 1 2" role="img"><title>A &amp; B</title>')
    assert 'id="fig-p"' in found and "url(#fig-c)" in found and 'href="#fig-p"' in found
    assert "currentColor" in found and "#010203" not in found


@pytest.mark.nightly
def test_from_trainings_to_the_page(finished, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for algorithm in ("gctd3", "td3"):
        finished.copy(algorithm, tmp_path / "runs" / algorithm / "0")
        finished.copy(f"{algorithm} seed 1", tmp_path / "runs" / algorithm / "1")
    assert command("report", "runs=runs", "out=out", "episodes=2", "threads=1") == 0
    assert "Written to out/index.html" in capsys.readouterr().out
    assert all((tmp_path / "runs" / a / s / "evaluation.json").is_file() for a in ("gctd3", "td3") for s in "01")
    text = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    # Nothing is fetched from anywhere.
    assert (
        not re.findall(r'(?:src|href)="(?!#|data:image/jpeg;base64,)', text)
        and "@import" not in text
        and "url(http" not in text
    )
    assert "prefers-color-scheme: dark" in text and 'name="viewport"' in text
    ids = re.findall(r'\bid="([^"]+)"', text)
    assert len(ids) == len(set(ids))
    names = {file.stem for file in (tmp_path / "out" / "figures").glob("*.svg")}
    pixels = {file.stem for file in (tmp_path / "out" / "figures").glob("*.png")}
    # Without OpenGL the page says that it could not draw.
    films = {"film_gctd3", "film_td3"}
    assert pixels == names | films or (pixels == names and text.count("no filmstrip. ") == 2)
    assert text.count('class="film"') == len(pixels - names)
    assert {"curve_frames", "curve_wall_s", "curve_train_episodes", "performance_profile", "improvement"} <= names
    assert {"body_height", "joints_gctd3", "phase_gctd3", "contacts_td3"} <= names
    for file in (tmp_path / "out" / "figures").glob("*.svg"):
        ElementTree.parse(file)
    with (tmp_path / "out" / "tables" / "table5.csv").open(encoding="utf-8") as file:
        assert [row[0] for row in csv.reader(file)] == ["", "gctd3", "paper, GCTD3", "td3", "paper, TD3"]
    assert "no difference shown" in (tmp_path / "out" / "verdict.txt").read_text(encoding="utf-8")


@pytest.mark.nightly
def test_a_report_on_another_librarys_task(finished, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    finished.copy("library", tmp_path / "runs" / "a")
    assert command("report", "runs=runs", "out=out", "episodes=1") == 0
    assert "Walker2d-v5" in (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
