"""The viewer: what it says when it cannot start, and what a real browser shows of it."""

import os
import re
import shutil
import socket
import subprocess
import sys
import time

import pytest
from running import command, train

from gctd3 import view

BROWSER = next(filter(None, map(shutil.which, ("chromium-headless-shell", "chromium", "google-chrome"))), None)
# WebGL without a GPU.
SOFTWARE = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return train(tmp_path_factory.mktemp("trained") / "run")


def test_a_port_in_use_is_answered(capsys, run):
    with socket.create_server(("localhost", 0)) as taken:
        port = taken.getsockname()[1]
        assert command("view", f"run={run}", f"port={port}") == 2
    error = capsys.readouterr().err
    assert error.startswith(f"error: port={port} of host=localhost cannot be used: ") and "port=0" in error


def test_an_unknown_host_is_answered(capsys, run):
    assert command("view", f"run={run}", "host=nowhere.invalid") == 2
    assert capsys.readouterr().err.startswith("error: port=8080 of host=nowhere.invalid cannot be used: ")


def test_a_missing_package_is_answered(capsys, run, monkeypatch):
    monkeypatch.setattr(view, "PACKAGES", ("viser", "no_such_package"))
    assert command("view", f"run={run}") == 2
    assert capsys.readouterr().err == "error: The viewer needs no_such_package: pip install 'gctd3[view]'.\n"


def test_runs_to_choose_from(run, tmp_path):
    for age, name in enumerate(("newest", "oldest")):
        there = shutil.copytree(run, tmp_path / "runs" / "biped" / name)
        os.utime(there, (1e9 - age, 1e9 - age))
    (tmp_path / "runs" / "stopped" / "checkpoints").mkdir(parents=True)
    found = [str(tmp_path / "runs" / "biped" / name) for name in ("newest", "oldest")]
    assert view.choices(str(run), str(tmp_path / "runs")) == [str(run), *found]
    assert view.choices(found[1], str(tmp_path / "runs")) == [found[1], found[0]]
    assert view.choices(str(run), str(tmp_path / "none")) == [str(run)]


# In a browser.


@pytest.fixture(scope="module")
def page(run):
    api = pytest.importorskip("playwright.sync_api", reason="no Playwright")
    pytest.importorskip("mjviser", reason="no mjviser")
    if BROWSER is None:
        pytest.skip("no Chromium")
    call = [sys.executable, "-m", "gctd3.view", f"run={run}", f"runs={run.parent}", "port=0", "browser=false"]
    shown = subprocess.Popen(call, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        line = shown.stdout.readline()
        url = re.search(r"http://localhost:\d+", line)
        assert url, line + shown.stderr.read()
        with api.sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=BROWSER, args=SOFTWARE)
            # Small, since every pixel is drawn by the CPU.
            opened = browser.new_page(viewport={"width": 800, "height": 450})
            opened.set_default_timeout(120_000)
            opened.goto(url[0])
            opened.wait_for_selector("#status")
            yield opened
            browser.close()
    finally:
        shown.terminate()
        assert "Traceback" not in shown.communicate()[1]


def number(page, name):
    return float(page.locator(f"#status td.{name}").inner_text().split()[0])


def press(page, name):
    page.get_by_role("button", name=name, exact=True).click()


def until(true):
    for _ in range(300):
        if true():
            return True
        time.sleep(0.1)
    return False


def test_it_walks_pauses_and_is_pushed(page):
    before = number(page, "time")
    assert until(lambda: number(page, "time") != before)
    press(page, "Pause")
    assert until(lambda: page.get_by_role("button", name="Go on").is_visible())
    press(page, "Reset")
    assert until(lambda: number(page, "time") == 0.0)
    still = page.screenshot()
    time.sleep(1.0)
    assert number(page, "time") == 0.0

    def pushed_and_stepped(pushes):
        press(page, "Reset")
        assert until(lambda: number(page, "time") == 0.0)
        for _ in range(pushes):
            press(page, "Push forward")
        for steps in range(1, 4):
            press(page, "Step")
            assert until(lambda at=0.02 * steps: number(page, "time") == pytest.approx(at))
        return number(page, "speed"), number(page, "distance")

    speed, distance = pushed_and_stepped(0)
    faster, farther = pushed_and_stepped(4)
    # Each push is a quarter of the robot's mass times 1 m/s.
    assert faster - speed > 0.5
    assert farther > distance + 0.01
    assert page.screenshot() != still
    press(page, "Go on")
    assert until(lambda: number(page, "time") > 0.1)
