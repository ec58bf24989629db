"""The viewer before it opens a page: the runs to choose from, and its errors."""

import os
import shutil
import socket

import pytest
from running import command

from gctd3.runs import show
from gctd3.training.saved_configuration import find_run
from gctd3.viz.hosts import LOOPBACK, Names


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


@pytest.mark.parametrize("name", ["http://a.example", "a.example/", "a b", "", "a.example:port", "[::1"])
def test_a_name_that_no_browser_sends_is_answered(name, capsys):
    assert command("view", f"allowed_hosts=['{name}']") == 2
    said = f"error: allowed_hosts must hold names as example.org or example.org:8080, got {name!r}.\n"
    assert capsys.readouterr().err == said


@pytest.mark.parametrize(
    "host, port, accepted",
    [
        ("localhost:80", 80, True),
        ("localhost", 80, True),  # the default port of http
        ("localhost", 8080, False),
        ("a.example", 8080, True),
        ("A.example:1", 8080, True),
        ("b.example:90", 8080, True),
        ("b.example:8080", 8080, False),
        ("b.example", 8080, False),
        ("a.example.evil", 8080, False),
        ("evil@a.example", 8080, False),
        ("a.example,evil", 8080, False),
        ("[::1]:8080", 8080, True),
        ("[::2]:8080", 8080, False),
        ("", 8080, False),
        (None, 8080, False),
    ],
)
def test_names_of_the_viewer(host, port, accepted):
    assert Names(LOOPBACK, ["a.example", "b.example:90"]).accept(host, port) is accepted


def test_the_default_port_of_an_origin_is_that_of_its_scheme():
    names = Names(LOOPBACK, ["b.example:443"])
    assert names.accept_origin("https://b.example", 8080) and not names.accept_origin("http://b.example", 8080)
    assert names.accept_origin("http://localhost", 80) and not names.accept_origin("https://localhost", 80)


def test_runs_to_choose_from(tmp_path):
    for age, name in enumerate(("newest", "oldest")):
        there = shutil.copytree(find_run(None), tmp_path / "runs" / "biped" / name)
        os.utime(there, (1e9 - age, 1e9 - age))
    (tmp_path / "runs" / "stopped" / "checkpoints").mkdir(parents=True)
    found = [str(tmp_path / "runs" / "biped" / name) for name in ("newest", "oldest")]
    assert show.choices(None, str(tmp_path / "runs")) == [show.SHIPPED, *found]
    assert show.choices(found[1], str(tmp_path / "runs")) == [found[1], found[0], show.SHIPPED]
    assert show.choices(found[1], str(tmp_path / "none")) == [found[1], show.SHIPPED]
