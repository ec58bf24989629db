"""The viewer in a real browser: its buttons, sliders and choice of runs change the walk as labelled."""

import io
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest
from browsers import chromium
from PIL import Image
from running import wait_for

from gctd3.runs.show import SHIPPED
from gctd3.training.saved_configuration import find_run

pytest.importorskip("mjviser", reason="no mjviser")
# Every pixel is drawn by the CPU. The quick tests start the viewer as README says, and read its page in Python.
pytestmark = pytest.mark.nightly


@pytest.fixture(scope="module")
def runs(finished, tmp_path_factory):
    """Make a folder with the run of another robot, and with one that cannot be read."""
    folder = tmp_path_factory.mktemp("runs")
    finished.copy("quadruped", folder / "quadruped")
    shutil.copytree(find_run(None), folder / "broken")
    (weights,) = (folder / "broken").rglob("policy.safetensors")
    weights.write_bytes(b"")
    return folder


@pytest.fixture(scope="module")
def page(runs):
    call = [sys.executable, "-m", "gctd3.view", f"runs={runs}", "port=0", "browser=false"]
    shown = subprocess.Popen(call, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        with chromium() as browser:
            line = shown.stdout.readline()
            url = re.search(r"http://localhost:\d+", line)
            assert url, line + shown.stderr.read()
            # Small, since every pixel is drawn by the CPU.
            opened = browser.new_page(viewport={"width": 800, "height": 450})
            opened.set_default_timeout(120_000)
            wrong = []
            opened.on("pageerror", lambda error: wrong.append(str(error)))
            opened.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
            opened.goto(url[0])
            opened.wait_for_selector("#status")
            yield opened
            assert wrong == []
    finally:
        shown.terminate()
        assert shown.communicate()[1] == ""


def number(page, name):
    return float(page.locator(f"#status td.{name}").inner_text().split()[0])


def press(page, name):
    page.get_by_role("button", name=name, exact=True).click()


def fill(page, slider, value):
    row = page.get_by_text(slider, exact=True).locator("xpath=ancestor::*[3]")
    row.get_by_role("textbox").fill(str(value))
    row.get_by_role("textbox").press("Enter")


def pause(page):
    if page.get_by_role("button", name="Pause", exact=True).is_visible():
        press(page, "Pause")
    page.get_by_role("button", name="Go on").wait_for()


def restart(page):
    pause(page)
    press(page, "Reset")
    wait_for(lambda: number(page, "time") == 0.0)


def pushed(page, pushes):
    """Return speed (m/s) and distance (m) three control steps after a new start and pushes."""
    restart(page)
    for _ in range(pushes):
        press(page, "Push forward")
    for steps in range(1, 4):
        press(page, "Step")
        wait_for(lambda at=0.02 * steps: number(page, "time") == pytest.approx(at))
    return number(page, "speed"), number(page, "distance")


def scene(page):
    """Return the picture beside the controls, in squares of eight by eight pixels."""
    picture = Image.open(io.BytesIO(page.screenshot(clip={"x": 0, "y": 200, "width": 400, "height": 240})))
    return np.asarray(picture.convert("L").resize((50, 30), Image.Resampling.BOX)).astype(int)


def test_it_walks_pauses_and_is_pushed(page):
    before = number(page, "time")
    wait_for(lambda: number(page, "time") != before)
    restart(page)
    # On a busy machine the last picture comes late.
    wait_for(lambda: np.abs(scene(page) - scene(page)).max() < 20)
    still = scene(page)
    assert np.abs(scene(page) - still).max() < 20 and number(page, "time") == 0.0
    speed, distance = pushed(page, 0)
    faster, farther = pushed(page, 4)
    # Each push is a quarter of the robot's mass times 1 m/s.
    assert 0.5 < faster - speed < 1.5
    assert farther > distance + 0.01
    assert np.abs(scene(page) - still).max() > 60
    press(page, "Go on")
    wait_for(lambda: number(page, "time") > 0.1)


def test_ground_and_load_change_the_walk(page):
    def gained():
        return pushed(page, 4)[0] - pushed(page, 0)[0]

    light = gained()
    # About as much as the robot weighs.
    fill(page, "Payload, kg", 10)
    assert 0.3 < gained() / light < 0.7
    fill(page, "Payload, kg", 0)

    def velocity():
        restart(page)
        press(page, "Go on")
        wait_for(lambda: number(page, "time") > 1.0)
        pause(page)
        return number(page, "distance") / number(page, "time")

    assert velocity() > 0.6
    fill(page, "Friction", 0.05)
    assert velocity() < 0.4


def test_another_run_is_chosen(page, runs):
    def choose(name):
        page.get_by_role("combobox", name="Run").click()
        page.get_by_role("option", name=str(name), exact=True).click()

    pause(page)
    assert not page.get_by_role("button", name="Push left").is_visible()
    choose(runs / "quadruped")
    # The biped's boom does not let it move sideways.
    page.get_by_role("button", name="Push left").wait_for()
    assert number(page, "time") == 0.0
    choose(runs / "broken")
    page.get_by_text(re.compile("policy.safetensors")).wait_for()
    wait_for(lambda: page.get_by_role("combobox", name="Run").input_value() == str(runs / "quadruped"))
    assert page.get_by_role("button", name="Push left").is_visible()
    choose(SHIPPED)
    page.get_by_role("button", name="Push left").wait_for(state="hidden")
