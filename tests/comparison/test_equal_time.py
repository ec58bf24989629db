"""The report at equal wall-clock, on hand-made runs, and on a training and the policies that it kept."""

import csv
import json

import pytest
from made_up_runs import make
from running import command, rows

pytest.importorskip("matplotlib")

from gctd3.comparison.equal_time import reached, time_limit, uneven
from gctd3.comparison.groups import groups_of
from gctd3.comparison.report import report
from gctd3.comparison.runs import find_runs
from gctd3.comparison.settings import ReportSettings
from gctd3.comparison.tables import equal_time
from gctd3.comparison.verdict import verdict
from gctd3.files import read_manifest

TD3 = {"overrides": ["algo=td3"], "change": {"algo.tau": 0.01}}
HEAD = "frames,updates,wall_s,return_mean,success_rate,velocity_mean"


def timed(root, name, *lines, **settings):
    """Make a run with these lines of progress: frames, updates, seconds, return, success, m/s."""
    run = make(root, name, **settings)
    (run / "progress.csv").write_text("\n".join([HEAD, *lines]) + "\n")
    return run


@pytest.fixture
def sweep(tmp_path):
    """Make three seeds that train for 100, 120 and 200 s, and three that train for 240 s."""
    for seed, (end, last) in enumerate([(100, 300), (120, 330), (200, 900)]):
        timed(tmp_path, f"a{seed}", "1000,10,60,100,0.5,1", f"2000,30,{end},{last},1.0,1")
    for seed in range(3):
        lines = "1000,10,80,500,0.8,1", "2000,30,160,90,0.2,1", "3000,50,240,700,1.0,1"
        timed(tmp_path, f"b{seed}", *lines, **TD3)
    return tmp_path


def cells(root):
    """Return the table's rows by group, and the time at which it compares."""
    groups = groups_of(find_runs(root))
    limit = time_limit(groups)
    table = equal_time(groups, limit)
    return {row[0]: dict(zip(table.head[1:], row[1:], strict=True)) for row in table.rows}, limit


def test_the_time_is_the_shortest_median_training_time(sweep):
    _, limit = cells(sweep)
    assert (limit.seconds, limit.group, limit.text) == (120.0, "gctd3", "2.0 min")
    assert limit.medians == {"gctd3": 120.0, "td3": 240.0}


def test_what_was_reached_by_hand(sweep):
    by_group, _ = cells(sweep)
    # After 120 s the third seed, at 60 s of 60 to 200, is at 3/7 of its second thousand: 1,429 frames, 19 updates; it
    # has its first policy. Of three the interquartile mean is the mean: (300 + 330 + 100) / 3.
    ours = by_group["gctd3"]
    assert ours["return, IQM"].startswith("243.3 [") and ours["success, IQM"].startswith("0.83 [")
    assert ours["frames, thousands"].startswith("1.8 [") and ours["seeds evaluated"] == "3 of 3"
    assert ours["training, min, median"] == "2.00"
    # The others are halfway between 80 and 160 s: 1,500 frames and 20 updates each, their return 500 is not lost.
    theirs = by_group["td3"]
    assert theirs["return, IQM"] == "500.0 [500.0, 500.0]" and theirs["success, IQM"] == "0.80 [0.80, 0.80]"
    assert theirs["frames, thousands"] == "1.5 [1.5, 1.5]"
    assert reached(find_runs(sweep / "b0")[0], 120.0).updates == pytest.approx(20.0)


def test_the_policy_is_chosen_as_runs_choose_theirs(tmp_path):
    slow = {"stop_when": {"at_least": {"velocity_mean": 1.0}, "at_most": {}, "evaluations": None}}
    lines = "1000,10,60,100,0.5,1.1", "2000,30,90,300,0.9,0.5", "3000,50,120,200,0.7,1.2", "4000,70,150,200,0.1,1.2"
    run = find_runs(timed(tmp_path, "a0", *lines, change=slow))[0]
    # A walk that is fast enough ranks above a slower one with any return; among equals the first one stays.
    found = {seconds: reached(run, seconds) for seconds in (59.0, 60.0, 100.0, 120.0, 1000.0)}
    assert found.pop(59.0) is None
    assert [one.return_mean for one in found.values()] == [100.0, 100.0, 200.0, 200.0]
    # After its end a run keeps its results.
    last = found[1000.0]
    assert (last.success_rate, last.frames, last.updates) == (0.7, 4000.0, 70.0)


def test_a_training_keeps_what_the_report_says(finished):
    run = finished["gctd3"]
    seconds = [float(row["wall_s"]) for row in rows(run)]
    kept = read_manifest(next((run / "checkpoints").glob("best-*")))["metrics"]
    found = reached(find_runs(run)[0], seconds[-1])
    assert len(seconds) == 3 and sorted(seconds) == seconds
    assert (found.return_mean, found.success_rate) == (kept["return_mean"], kept["success_rate"])


@pytest.mark.nightly
def test_wall_clock_goes_on_where_a_training_is_resumed(finished, tmp_path):
    run = finished.copy("gctd3", tmp_path / "a")
    before = rows(run)
    assert command("train", f"resume={run}", "total_frames=320") == 0
    after = rows(run)
    assert after[: len(before)] == before
    assert float(before[-1]["wall_s"]) < float(after[-1]["wall_s"]) < float(before[-1]["wall_s"]) + 60


def test_stopped_and_crashed_runs_do_not_set_the_time(sweep):
    for run in ("a0", "a1"):
        config = json.loads((sweep / run / ".hydra" / "config.yaml").read_text())
        (sweep / run / ".hydra" / "config.yaml").write_text(json.dumps({**config, "total_frames": 9000}))
    for run in sweep.glob("*[2b]*"):
        config = json.loads((run / ".hydra" / "config.yaml").read_text())
        (run / ".hydra" / "config.yaml").write_text(json.dumps({**config, "total_frames": 2000}))
    runs = find_runs(sweep)
    assert sum(run.trouble is not None for run in runs) == 2
    limit = time_limit({"gctd3": runs[:3], "td3": runs[3:]})
    assert (limit.seconds, limit.group) == (200.0, "gctd3")


def test_late_and_single_seeds_and_other_computers_are_said(tmp_path):
    timed(tmp_path, "a0", "1000,10,60,100,1.0,1")
    for seed in (0, 1):
        change = {"algo.tau": 0.01, "threads": 7}
        line = "1000,10,70,900,1.0,1" if seed else "1000,10,60,800,1.0,1"
        timed(tmp_path, f"b{seed}", line, overrides=["algo=td3"], change=change)
    by_group, limit = cells(tmp_path)
    assert limit.seconds == 60.0 and by_group["td3"]["seeds evaluated"] == "1 of 2"
    said = "\n".join(verdict(groups_of(find_runs(tmp_path))))
    assert (
        "return after 1.0 min of training: no difference shown, a single seed cannot show one: "
        "100.0 (1 seed) against 800.0 (1 seed)." in said
    )
    assert "td3: 1 of 2 seeds had evaluated no policy after 1.0 min" in said
    assert "Times are not like for like, threads differs: 0 in gctd3; 7 in td3." in said


def test_runs_without_wall_clock_are_reported_without_it(tmp_path):
    for name, more in (("a0", {}), ("b0", TD3)):
        run = make(tmp_path / "runs", name, **more)
        (run / "progress.csv").write_text("frames,return_mean,success_rate\n1000,100,1.0\n")
    page = report(ReportSettings(str(tmp_path / "runs"), str(tmp_path / "out")))
    text = page.read_text(encoding="utf-8")
    assert "Nothing is compared at equal wall-clock" in text and 'id="equal-wall-clock"' not in text
    assert not (tmp_path / "out" / "tables" / "equal_time.csv").exists()


@pytest.mark.nightly
def test_the_page_has_it_beside_table_5(sweep, tmp_path):
    page = report(ReportSettings(str(sweep), str(tmp_path / "out"))).read_text(encoding="utf-8")
    places = [page.index(f'<h2 id="{name}">') for name in ("table-5", "equal-wall-clock", "gait")]
    assert places == sorted(places) and "What each run had reached after 2.0 min of wall-clock" in page
    with (tmp_path / "out" / "tables" / "equal_time.csv").open(encoding="utf-8") as file:
        row = list(csv.DictReader(file))[1]
        assert [row[f"return, IQM{end}"] for end in ("", ", low", ", high")] == ["500.0"] * 3
    assert "Dashed, where the groups are compared" in page


def costs(root):
    return [line for line in verdict(groups_of(find_runs(root))) if "a whole run took" in line]


def test_the_verdict_says_what_runs_cost(tmp_path):
    for seed, end in enumerate([90, 96, 108]):
        timed(tmp_path, f"a{seed}", f"1000,10,{end},100,1.0,1")
        timed(tmp_path, f"b{seed}", "1000,10,30,100,1.0,1", **TD3)
    # Of 90, 96 and 108 s.
    ours, theirs = costs(tmp_path)
    assert ours.endswith("that was evaluated; a whole run took 1.6 min in the median (1.5 to 1.8).")
    assert theirs.endswith("that was evaluated; a whole run took 30.0 s.")
    for run in tmp_path.glob("a*"):
        (run / "post_mortem").mkdir()
    assert [line.split(":")[0] for line in costs(tmp_path)] == ["td3"]


def many(root, *seconds):
    """Make five seeds that train for that long and return much, and five that train for 95 s and return little."""
    for seed, end in enumerate(seconds):
        timed(root, f"a{seed}", f"1000,10,{0.4 * end},800,1.0,1", f"2000,20,{end},80{seed},1.0,1", returns=800 + seed)
        timed(root, f"b{seed}", "1000,10,40,5,0.0,1", f"2000,20,95,1{seed},0.0,1", returns=10 + seed, **TD3)


@pytest.mark.nightly
def test_no_difference_is_sought_by_wall_clock_where_the_machine_was_shared(tmp_path):
    many(tmp_path / "alike", 94, 95, 96, 97, 98)
    said = verdict(groups_of(find_runs(tmp_path / "alike")))
    # Return, velocity; return and success after 95 s. No run of td3 finishes, so that no times are compared.
    assert said[0].startswith("In short: 4 comparisons, 3 of which show a difference")
    assert not any("machine" in line for line in said)
    many(tmp_path / "shared", 145, 146, 145, 146, 95)
    said = verdict(groups_of(find_runs(tmp_path / "shared")))
    assert said[0] == "In short: 2 comparisons, 1 of which shows a difference: gctd3 returns more than td3 (return)."
    assert "gctd3: 5 of 5" in said[1] and "(1.6 to 2.4)" in said[1]
    why = (
        "Wall-clock is of little worth here, and no difference is sought by it: these runs did not all have the same "
        "machine to themselves, for 2,000 frames took 1.6 min and 2.4 min in gctd3."
    )
    assert said.count(why) == 1 and not any(" min of training: " in line for line in said)
    page = report(ReportSettings(str(tmp_path / "shared"), str(tmp_path / "out"))).read_text(encoding="utf-8")
    section = page[page.index('id="equal-wall-clock"') : page.index('id="gait"')]
    assert why in section and "At equal wall-clock" in section


def test_times_to_the_finish_are_wall_clock_too(tmp_path):
    for seed, end in enumerate([100, 100, 100, 100, 150]):
        timed(tmp_path, f"a{seed}", f"1000,10,{end},100,1.0,1")
        timed(tmp_path, f"b{seed}", "1000,10,20,100,1.0,1", **TD3)
    said = "\n".join(verdict(groups_of(find_runs(tmp_path))))
    assert "time to the first evaluation" not in said and "did not all have the same machine to themselves" in said


@pytest.mark.parametrize(
    "lines, apart",
    [
        # After 1,000 frames, which both have, 60 and 70 s; the further frames of one of them do not count.
        (("1000,10,60,1,0,1", "1000,10,70,1,0,1\n3000,30,300,1,0,1"), []),
        (("1000,10,60,1,0,1", "1000,10,75,1,0,1"), ["1,000 frames took 1.0 min and 1.2 min in gctd3"]),
        # Halfway between 500 frames at 20 s and 1,500 at 60 s: 40 s.
        (("1000,10,50,1,0,1", "500,10,20,1,0,1\n1500,30,60,1,0,1"), ["1,000 frames took 40.0 s and 50.0 s in gctd3"]),
    ],
)
def test_times_for_the_same_work_by_hand(tmp_path, lines, apart):
    for seed, line in enumerate(lines):
        timed(tmp_path, f"a{seed}", line)
    assert uneven(groups_of(find_runs(tmp_path))) == apart
    # A crashed run may have crashed because of its machine.
    (tmp_path / "a1" / "post_mortem").mkdir()
    assert uneven(groups_of(find_runs(tmp_path))) == []
