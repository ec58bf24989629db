"""A run on a disk that cannot be written to is evaluated and shown; work whose result cannot be kept is not begun."""

import errno
import os
import subprocess
from pathlib import Path

import pytest
from running import command, process

from gctd3 import files
from gctd3.files import unwritable

ROFS = os.strerror(errno.EROFS)


@pytest.fixture
def read_only(finished, tmp_path, monkeypatch):
    """Return a run below which the system refuses to make files."""
    run, make = finished.copy("gctd3", tmp_path / "run"), files._make_file

    def refuse(path):
        if path.is_relative_to(run):
            raise OSError(errno.EROFS, ROFS, str(path))
        make(path)

    monkeypatch.setattr(files, "_make_file", refuse)
    return run


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_table_is_shown_and_where_nothing_was_written(read_only, capsys):
    before = contents(read_only)
    assert command("evaluate", f"run={read_only}", "episodes=2", "threads=1") == 0
    said = capsys.readouterr()
    line = f"Nothing is written to {read_only}: {ROFS}: {read_only}. out=DIR writes elsewhere."
    assert said.err.startswith(line)  # before the simulation
    assert "return" in said.out and "±" in said.out and said.out.rstrip().endswith(line)
    assert contents(read_only) == before


def test_out_writes_elsewhere(read_only, tmp_path, capsys):
    out = tmp_path / "out"
    assert command("evaluate", f"run={read_only}", "episodes=2", "threads=1", f"out={out}") == 0
    assert {path.name for path in out.iterdir()} == {"evaluation.json", "trace.csv"}
    assert "Nothing is written" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("evaluate", ["out={run}/new/deep"]),
        ("render", ["out={run}/walk.png"]),
        ("export", ["out={run}/policy.onnx"]),
    ],
)
def test_a_place_that_was_asked_for_is_refused_before_the_work(read_only, monkeypatch, capsys, name, arguments):
    def working(*arguments, **more):
        pytest.fail("it has begun to work")

    for work in ("gctd3.runs.evaluate.evaluate", "gctd3.runs.draw.record", "gctd3.deploy.export.rehearse"):
        monkeypatch.setattr(work, working)
    given = [argument.format(run=read_only) for argument in arguments]
    assert command(name, f"run={read_only}", *given) == 2
    error = capsys.readouterr().err
    assert ROFS in error and given[0] in error and "Traceback" not in error


def test_a_disk_that_is_full_by_the_end_does_not_cost_the_table(finished, tmp_path, monkeypatch, capsys):
    run = finished.copy("gctd3", tmp_path / "run")

    def full(path, text):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    monkeypatch.setattr("gctd3.runs.evaluate.write_text", full)
    assert command("evaluate", f"run={run}", "episodes=2", "threads=1") == 2
    said = capsys.readouterr()
    assert "this policy" in said.out and "return" in said.out
    assert said.err == f"error: {os.strerror(errno.ENOSPC)}: {run / 'trace.csv'}\n"


def test_what_is_writable(tmp_path):
    assert unwritable(tmp_path) is None and unwritable(tmp_path / "new" / "deep") is None
    assert not list(tmp_path.iterdir())
    (tmp_path / "file").touch()
    assert unwritable(tmp_path / "file") == f"{tmp_path / 'file'} is not a directory"
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    assert "is not a directory" in unwritable(tmp_path / "link" / "new")


@pytest.mark.nightly
def test_a_disk_that_is_mounted_read_only(finished, tmp_path):
    run = finished.copy("gctd3", tmp_path / "run")
    mounted = subprocess.run(["mount", "--bind", str(run), str(run)], capture_output=True)
    if (
        mounted.returncode
        or subprocess.run(["mount", "-o", "remount,ro,bind", str(run)], capture_output=True).returncode
    ):
        pytest.skip("nothing can be mounted here")
    try:
        done = process("evaluate", f"run={run}", "episodes=2", "threads=1")
        assert done.returncode == 0 and "this policy" in done.stdout and f"Nothing is written to {run}" in done.stderr
        resumed = process("train", f"resume={run}", "total_frames=400")
        assert resumed.returncode == 2 and ROFS in resumed.stderr and "Traceback" not in resumed.stderr
    finally:
        subprocess.run(["umount", str(run)], check=True)
    assert not Path(run, "evaluation.json").exists()
