"""A robot is steered in a real browser: keys and sliders change the command that the page shows."""

import re
import subprocess
import sys

import pytest
from browsers import chromium
from running import wait_for

pytest.importorskip("mjviser", reason="no mjviser")
# Every pixel is drawn by the CPU.
pytestmark = pytest.mark.nightly


@pytest.fixture(scope="module")
def page(finished, tmp_path_factory):
    empty = tmp_path_factory.mktemp("runs")
    call = [sys.executable, "-m", "gctd3.view", f"run={finished['velocity']}", f"runs={empty}", "port=0"]
    shown = subprocess.Popen([*call, "browser=false"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        with chromium() as browser:
            line = shown.stdout.readline()
            url = re.search(r"http://localhost:\d+", line)
            assert url, line + shown.stderr.read()
            opened = browser.new_page(viewport={"width": 800, "height": 450})
            opened.set_default_timeout(120_000)
            wrong = []
            opened.on("pageerror", lambda error: wrong.append(str(error)))
            opened.goto(url[0])
            opened.wait_for_selector("#status")
            yield opened
            assert wrong == []
    finally:
        shown.terminate()
        assert shown.communicate()[1] == ""


def command(page):
    """Return the command that the page shows: forward, to the left (m/s), turning (rad/s)."""
    text = page.locator("#status td.command").last.inner_text()
    return [float(number) for number in re.findall(r"[+-]\d+\.\d+", text)]


def test_keys_and_sliders_steer(page):
    page.locator("body").press("x")
    wait_for(lambda: command(page) == [0.0, 0.0, 0.0])
    for key, expected in (
        ("w", [0.15, 0.0, 0.0]),
        ("w", [0.3, 0.0, 0.0]),
        ("d", [0.3, -0.08, 0.0]),
        ("q", [0.3, -0.08, 0.16]),
        ("s", [0.15, -0.08, 0.16]),
        ("x", [0.0, 0.0, 0.0]),
    ):
        page.locator("body").press(key)
        wait_for(lambda expected=expected: command(page) == pytest.approx(expected, abs=0.006))
    row = page.get_by_text("Forward, m/s", exact=True).locator("xpath=ancestor::*[3]")
    row.get_by_role("textbox").fill("0.7")
    row.get_by_role("textbox").press("Enter")
    wait_for(lambda: command(page) == pytest.approx([0.7, 0.0, 0.0], abs=0.006))
    assert len(re.findall(r"m/s|rad/s", page.locator("#status td.follows").last.inner_text())) == 3
