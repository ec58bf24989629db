"""The viewer before it opens a page: the runs to choose from, and its errors."""

import os
import shutil
import socket

from running import command

from gctd3.runs import show
from gctd3.training.saved_configuration import find_run


def test_a_port_in_use_is_answered(capsys):
    with socket.create_server(("localhost", 0)) as taken:
        port = taken.getsockname()[1]
        assert command("view", f"port={port}") == 2
    error = capsys.readouterr().err
    assert error.startswith(f"error: port={port} of host=localhost cannot be used: ") and "port=0" in error


def test_an_unknown_host_is_answered(capsys):
    assert command("view", "host=nowhere.invalid") == 2
    assert capsys.readouterr().err.startswith("error: port=8080 of host=nowhere.invalid cannot be used: ")


def test_a_missing_package_is_answered(capsys, monkeypatch):
    monkeypatch.setattr(show, "PACKAGES", ("viser", "no_such_package"))
    assert command("view") == 2
    assert capsys.readouterr().err == "error: The viewer needs no_such_package: pip install 'gctd3[view]'.\n"


def test_runs_to_choose_from(tmp_path):
    for age, name in enumerate(("newest", "oldest")):
        there = shutil.copytree(find_run(None), tmp_path / "runs" / "biped" / name)
        os.utime(there, (1e9 - age, 1e9 - age))
    (tmp_path / "runs" / "stopped" / "checkpoints").mkdir(parents=True)
    found = [str(tmp_path / "runs" / "biped" / name) for name in ("newest", "oldest")]
    assert show.choices(None, str(tmp_path / "runs")) == [show.SHIPPED, *found]
    assert show.choices(found[1], str(tmp_path / "runs")) == [found[1], found[0], show.SHIPPED]
    assert show.choices(found[1], str(tmp_path / "none")) == [found[1], show.SHIPPED]
