"""A report is written over an earlier report only, and then replaces all of it."""

import shutil

import pytest
from made_up_runs import examined, make
from running import command

pytest.importorskip("matplotlib")

from gctd3.comparison.output_directory import check_place, in_place
from gctd3.comparison.report import report
from gctd3.comparison.settings import ReportSettings


@pytest.fixture
def runs(tmp_path):
    make(tmp_path / "runs", "a0")
    return tmp_path / "runs"


def contents(root):
    """Read every file below ``root``, by path."""
    return {str(file.relative_to(root)): file.read_bytes() for file in root.rglob("*") if file.is_file()}


@pytest.mark.parametrize(
    "make_out, out, said",
    [
        (lambda root: (root / "site" / "index.html").write_text("mine"), "site", "holds index.html, but no report"),
        (lambda root: (root / "site" / "notes").write_text("mine"), "site", "holds notes, but no report"),
        (lambda root: (root / "file").write_text("mine"), "file", "cannot be a directory"),
        (lambda root: (root / "file").write_text("mine"), "file/deep/down", "cannot be a directory"),
        (lambda root: (root / "link").symlink_to(root / "nowhere"), "link", "cannot be a directory"),
    ],
)
def test_what_is_no_report_is_not_written_over(runs, tmp_path, capsys, make_out, out, said):
    # The check comes before the evaluation of this run, which takes long.
    (runs / "a0" / "evaluation.json").unlink()
    (tmp_path / "site").mkdir()
    make_out(tmp_path)
    before = contents(tmp_path)
    assert command("report", f"runs={runs}", f"out={tmp_path / out}") == 2
    error = capsys.readouterr().err
    assert said in error and "choose a" in error and "evaluating" not in error
    assert contents(tmp_path) == before


@pytest.mark.nightly
def test_empty_and_absent_directories_are_written_to(runs, tmp_path):
    (tmp_path / "empty").mkdir()
    for out in ("empty", "absent/below"):
        report(ReportSettings(str(runs), str(tmp_path / out)))
        assert (tmp_path / out / "index.html").is_file()


@pytest.mark.nightly
def test_a_new_report_leaves_nothing_of_the_one_before(runs, tmp_path):
    examined(runs / "a0", 0.8, [2.0, 4.0])
    make(runs, "b0", overrides=["algo=td3"], change={"algo.tau": 0.01})
    out, fresh = tmp_path / "out", tmp_path / "fresh"
    report(ReportSettings(str(runs), str(out)))
    before = set(contents(out))
    (out / "figures" / "notes.md").write_text("mine")
    shutil.rmtree(runs / "b0")
    (runs / "a0" / "robustness.json").unlink()
    for place in (out, fresh):
        report(ReportSettings(str(runs), str(place)))
    gone = {"tables/settings.csv", "tables/equal_time.csv", "tables/robustness.csv", "figures/improvement.svg"}
    assert gone | {"figures/improvement.png", "figures/pushes.png"} <= before
    # The report equals that in an empty directory; other files stay.
    assert contents(out) == {**contents(fresh), "figures/notes.md": b"mine"}


@pytest.mark.nightly
def test_kept_runs_stay_when_the_report_beside_them_is_made_again(runs, tmp_path):
    out = tmp_path / "out"
    report(ReportSettings(str(runs), str(out), True))
    before = contents(out)
    report(ReportSettings(str(out / "runs"), str(out)))
    assert contents(out) == before
    # A directory with nothing but runs is accepted too.
    for name in ("index.html", "verdict.txt"):
        (out / name).unlink()
    for folder in ("figures", "tables"):
        shutil.rmtree(out / folder)
    report(ReportSettings(str(out / "runs"), str(out)))
    assert contents(out) == before


@pytest.mark.nightly
def test_a_report_that_fails_leaves_the_one_before(runs, tmp_path, monkeypatch):
    out = tmp_path / "out"
    report(ReportSettings(str(runs), str(out)))
    before = contents(out)
    with pytest.raises(KeyboardInterrupt), in_place(out) as aside:
        (aside / "index.html").write_text("half")
        raise KeyboardInterrupt
    assert contents(out) == before
    # Temporary files of a killed report are no reason to refuse.
    killed = tmp_path / "killed"
    (killed / ".report.1f2e.tmp" / "figures").mkdir(parents=True)
    check_place(killed, runs)
    report(ReportSettings(str(runs), str(killed)))
    assert contents(killed) == before
    assert not list(killed.glob(".*.tmp"))
