"""Damaged files of runs are named with a remedy, and files that a killed run leaves do not stop the report."""

import re

import pytest
from made_up_runs import make
from running import command

pytest.importorskip("matplotlib")

from gctd3.comparison.report import report
from gctd3.comparison.runs import find_runs, lost_runs
from gctd3.comparison.settings import ReportSettings
from gctd3.errors import RunError


@pytest.mark.parametrize(
    "file, content, said",
    [
        (".hydra/overrides.yaml", "- [", "it is damaged or of another version"),
        (".hydra/overrides.yaml", "", "it does not hold a list"),
        (".hydra/overrides.yaml", "algo: td3", "it does not hold a list"),
        (".hydra/config.yaml", "robot: {", "it is damaged or of another version"),
        ("progress.csv", "frames,wall_s\n1000,60\n2000,x1\n", "line 3, could not convert string to float: 'x1'"),
        ("progress.csv", "frames,wall_s\n1000,60\n2000\n", "line 3, 1 cells under 2 columns"),
        ("progress.csv", "wall_s,return_mean\n60,1\n", "not every line says how many frames"),
        ("progress.csv", "frames,wall_s\n,60\n", "not every line says how many frames"),
        ("progress.csv", b"frames\n\xff\n", "line 1, 'utf-8' codec can't decode"),
        ("trace.csv", "time_s,position_m\n0.02,nothing\n", "line 2, could not convert string to float: 'nothing'"),
        ("trace.csv", "time_s,position_m\n0.02\n", "line 2, 1 cells under 2 columns"),
    ],
)
def test_a_damaged_file_is_named_with_what_to_do(tmp_path, capsys, file, content, said):
    make(tmp_path / "runs", "a0")
    run = make(tmp_path / "runs", "a1")
    (run / file).write_bytes(content if isinstance(content, bytes) else content.encode())
    assert command("report", f"runs={tmp_path / 'runs'}", f"out={tmp_path / 'out'}") == 2
    error = capsys.readouterr().err
    assert str(run / file) in error and said in error
    remedy = "delete it, or evaluate the run again" if file == "trace.csv" else f"ove {run} elsewhere to report on the"
    assert remedy in error
    assert not (tmp_path / "out").exists()


def test_an_empty_progress_and_an_empty_trace_are_of_runs_without(tmp_path):
    run = make(tmp_path, "a0")
    for name in ("progress.csv", "trace.csv"):
        (run / name).write_text("")
    found = find_runs(tmp_path)[0]
    assert found.rows == [] and found.trace is None


@pytest.mark.parametrize(
    "left", ["\0\0\0\0", *(pytest.param(text, marks=pytest.mark.nightly) for text in ("", "\n", None))]
)
def test_runs_without_a_configuration_are_named_and_the_rest_is_reported(tmp_path, left):
    runs = tmp_path / "runs"
    make(runs, "a0")
    config = make(runs, "a1") / ".hydra" / "config.yaml"
    config.unlink()
    if left is not None:
        config.write_text(left)
    assert [run.name for run in find_runs(runs)] == ["a0"] and lost_runs(runs) == ["a1"]
    said = "a1 crashed: its .hydra/config.yaml is empty or missing, so it is in no group and has no numbers."
    text = report(ReportSettings(str(runs), str(tmp_path / "out"), True)).read_text(encoding="utf-8")
    assert said in text and "gctd3: 1 of 1 seeds" in text
    # Such runs are kept.
    again = report(ReportSettings(str(tmp_path / "out" / "runs"), str(tmp_path / "again")))
    assert again.with_name("verdict.txt").read_text() == (tmp_path / "out" / "verdict.txt").read_text()


def test_nothing_but_runs_without_a_configuration_is_no_runs(tmp_path):
    (make(tmp_path, "a0") / ".hydra" / "config.yaml").write_text("")
    with pytest.raises(RunError, match=re.escape("none of its directories has a .hydra/config.yaml")):
        find_runs(tmp_path)
