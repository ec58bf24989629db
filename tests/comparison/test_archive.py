"""Runs that a report keeps without their checkpoints give the same report again."""

import pytest
from made_up_runs import examined, make
from running import command

pytest.importorskip("matplotlib")

from gctd3.comparison.report import report
from gctd3.comparison.settings import ReportSettings
from gctd3.errors import RunError
from gctd3.files import write_manifest


def numbers(out):
    """Read all texts and tables of a report."""
    return {file.name: file.read_bytes() for file in [*out.glob("tables/*.csv"), out / "verdict.txt"]}


@pytest.mark.nightly
def test_a_report_of_kept_runs_has_the_same_numbers(finished, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for algorithm in ("gctd3", "td3"):
        finished.copy(algorithm, tmp_path / "runs" / algorithm / "0")
        finished.copy(f"{algorithm} seed 1", tmp_path / "runs" / algorithm / "1")
    assert command("report", "runs=runs", "out=out", "episodes=2", "threads=1", "keep_runs=true") == 0
    kept = tmp_path / "out" / "runs"
    assert not list(kept.rglob("*.safetensors")) and len(list(kept.rglob("evaluation.json"))) == 4
    # The drawn trace of each algorithm.
    assert len(list(kept.rglob("trace.csv"))) == 2
    robots, rest = [], []
    for file in kept.rglob("*"):
        (robots if "robot" in file.relative_to(kept).parts else rest).append(file.stat().st_size)
    # A run is read by its own copy of its robot.
    assert sum(robots) < 4 * 40_000
    assert sum(rest) - sum(file.stat().st_size for file in kept.rglob("trace.csv")) < 4 * 20_000
    assert command("report", "runs=out/runs", "out=again", "threads=1") == 0
    found = numbers(tmp_path / "out")
    assert {"table5.csv", "equal_time.csv", "runs.csv", "verdict.txt"} <= set(found)
    assert numbers(tmp_path / "again") == found
    pictures = {file.name for file in (tmp_path / "out" / "figures").iterdir()}
    again = {file.name for file in (tmp_path / "again" / "figures").iterdir()}
    assert {name for name in pictures - again if not name.startswith("film_")} == set() and again <= pictures
    for name in again:
        assert (tmp_path / "again" / "figures" / name).read_bytes() == (
            tmp_path / "out" / "figures" / name
        ).read_bytes()
    text = (tmp_path / "again" / "index.html").read_text(encoding="utf-8")
    assert text.count("no filmstrip. gctd3/") == 1 and "has numbers only, no policy." in text
    # A report of the runs themselves, all evaluated by now, has the same page.
    assert command("report", "runs=runs", "out=once_more", "threads=1") == 0
    pages = [(tmp_path / out / "index.html").read_text(encoding="utf-8") for out in ("out", "once_more")]
    assert pages[0] == pages[1]


@pytest.mark.nightly
def test_crashed_and_examined_runs_are_kept_as_such(tmp_path):
    runs = tmp_path / "runs"
    examined(make(runs, "a0"), 0.8, [2.0, 4.0])
    crashed = make(runs, "a1", evaluation=False)
    (crashed / "post_mortem").mkdir()
    write_manifest(crashed / "post_mortem", {"error": "After 7 steps, the loss is nan."})
    (crashed / "post_mortem" / "state.safetensors").write_bytes(b"much")
    report(ReportSettings(str(runs), str(tmp_path / "out"), True))
    assert not list((tmp_path / "out" / "runs").rglob("*.safetensors"))
    report(ReportSettings(str(tmp_path / "out" / "runs"), str(tmp_path / "again")))
    found = numbers(tmp_path / "out")
    assert b"the loss is nan" in found["verdict.txt"] and "robustness.csv" in found
    assert numbers(tmp_path / "again") == found


def test_nothing_is_overwritten_nor_found_twice(tmp_path):
    make(tmp_path / "runs", "a0")
    (tmp_path / "out" / "runs").mkdir(parents=True)
    with pytest.raises(RunError, match="exists already"):
        report(ReportSettings(str(tmp_path / "runs"), str(tmp_path / "out"), True))
    with pytest.raises(RunError, match="would find the copies of keep_runs=true"):
        report(ReportSettings(str(tmp_path / "runs"), str(tmp_path / "runs" / "report"), True))
    assert not (tmp_path / "runs" / "report").exists()
