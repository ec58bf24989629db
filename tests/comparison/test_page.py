"""The report's page in a browser, if one is installed: complete, offline, narrow and wide, light and dark."""

import json
import re
import shutil
from functools import partial
from itertools import product

import numpy as np
import pytest
from browsers import chromium
from made_up_runs import examined, make
from omegaconf import OmegaConf

from gctd3.errors import RenderError
from gctd3.training.saved_configuration import CONFIG, find_run
from gctd3.viz.offscreen import find_backend

pytest.importorskip("matplotlib")
from gctd3.comparison import filmstrips
from gctd3.comparison.gaits import GAIT

# Its pictures alone take ten seconds.
pytestmark = pytest.mark.nightly
# As many groups as the page has room for at 1280 pixels.
TAUS = (0.001, 0.002, 0.003, 0.004, 0.005, 0.006)
GROUPS = [f"gctd3 tau={tau}" for tau in TAUS]
# A run's name is data: this one asks for a file and writes to the console, if a page takes it for HTML.
NAME = "<img src=x onerror=console.log(1)>\"'&lt;"
DT = 0.02
# The titles of all pictures of a group with a trace and a policy.
OF_A_GROUP = {"joints, right against left", "phase portraits", "feet on the ground"}
FIGURES = {
    "Return over frames, thousands",
    "Return over wall-clock, minutes",
    "Return over training episodes",
    "Performance profile",
    "Probability of improvement",
    "Body height",
    "Success under other conditions",
    "Pushes survived over the stride",
} | {f"{group}, seed 0: {what}" for group in GROUPS[:2] for what in OF_A_GROUP}


def trace(robot):
    """Make up four seconds of a gait whose right and left legs take turns."""
    time = DT * np.arange(1, 200)
    columns = {"time_s": time, "height_m": 0.02 * np.sin(18.0 * time)}
    for leg in robot.legs:
        for joint in leg:
            phase = 9.0 * time + (np.pi if "left" in joint.name else 0.0)
            columns |= {f"angle_{joint.name}_rad": np.sin(phase), f"velocity_{joint.name}_rad_s": 9.0 * np.cos(phase)}
    columns |= {f"down_{foot}": np.sin(9.0 * time + np.pi * i) > 0.0 for i, foot in enumerate(robot.feet)}
    rows = [",".join(f"{float(value):.4f}" for value in row) for row in zip(*columns.values(), strict=True)]
    return "\n".join([",".join(columns), *rows]) + "\n"


def gait(seed):
    """Make up every metric, with as many digits as trained policies have; some seeds have no strides."""
    found = {key: 10.0 ** (4 if key == "action_jerk" else 0) * -(2.345 + 5.1 * seed) for key, *_ in GAIT}
    return found | {"asymmetry_hip_right": 0.02, "stride_time": 0.8 if seed == 0 else None, "periodic_fraction": 0.4}


@pytest.fixture(scope="module")
def runs(tmp_path_factory, robot):
    """Make two seeds of each of six settings; the first has all files of a training and its evaluations."""
    root, shipped = tmp_path_factory.mktemp("report") / "runs", find_run(None)
    for tau in TAUS:
        for seed in range(2):
            run = make(root, f"tau={tau},{seed}", 500.0 + seed)
            config = OmegaConf.load(shipped / CONFIG)
            frames = {"total_frames": 2000, "exploration": {"learning_starts": 1000}}
            OmegaConf.save(OmegaConf.merge(config, frames, {"seed": seed, "algo": {"tau": tau}}), run / CONFIG)
            evaluated = json.loads((run / "evaluation.json").read_text())
            (run / "evaluation.json").write_text(json.dumps({**evaluated, "gait": gait(seed)}))
            examined(run, 0.8, [2.0, 4.0])
            if tau in TAUS[:2]:
                (run / "trace.csv").write_text(trace(robot))
    shutil.copytree(shipped / "checkpoints", root / f"tau={TAUS[0]},0" / "checkpoints")
    # The last run was stopped, which makes its outcome a long text.
    progress = run / "progress.csv"
    progress.write_text("".join(progress.read_text().splitlines(keepends=True)[:2]))
    run.rename(root / NAME)
    return root


@pytest.fixture(scope="module")
def page_file(runs):
    from gctd3.comparison.report import report
    from gctd3.comparison.settings import ReportSettings

    with pytest.MonkeyPatch.context() as patch:
        # A stride is in the first seconds of a walk as well.
        patch.setattr(filmstrips, "record", partial(filmstrips.record, most_steps=120))
        return report(ReportSettings(str(runs), str(runs.parent / "out")))


@pytest.fixture(scope="module")
def browser():
    with chromium() as opened:
        yield opened


@pytest.fixture
def opened(browser, page_file):
    """Return a function that opens the page; the console must stay empty, and nothing else be requested."""
    contexts, said, asked = [], [], []

    def look(width, scheme="light", unfolded=True):
        contexts.append(
            browser.new_context(viewport={"width": width, "height": 800}, color_scheme=scheme, offline=True)
        )
        page = contexts[-1].new_page()
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(page_file.resolve().as_uri())
        if unfolded:
            page.evaluate("document.querySelectorAll('details').forEach(e => { e.open = true })")
        return page

    yield look
    assert said == []
    # The frames are inside the file.
    assert [url for url in asked if not url.startswith("data:image/jpeg;base64,")] == [page_file.resolve().as_uri()]
    for context in contexts:
        context.close()


def every(page, selector, what):
    """Evaluate ``what`` for every element ``e`` that the selector finds."""
    return page.evaluate(f"[...document.querySelectorAll('{selector}')].map(e => {what})")


def films():
    """Return the headings of the films that can be drawn here."""
    try:
        find_backend()
    except RenderError:
        return set()
    return {f"{GROUPS[0]}, seed 0: a stride"}


@pytest.mark.parametrize("width", [375, 1280])
def test_every_figure_is_there_and_has_a_size(opened, width):
    page = opened(width)
    titles = every(page, "figure h3", "e.textContent")
    assert len(titles) == len(set(titles)) and set(titles) == FIGURES | films()
    drawings = every(page, "figure svg", "[e.getBoundingClientRect().width, e.getBoundingClientRect().height]")
    assert len(drawings) == len(FIGURES)
    assert all(w > 250 and h > 60 for w, h in drawings)
    frames = every(page, "figure img", "[e.naturalWidth, e.getBoundingClientRect().width]")
    assert len(frames) == filmstrips.FRAMES * len(films())
    # Each frame shows the robot, with its words below it.
    assert all(pixels >= shown >= 120 for pixels, shown in frames)
    assert len(every(page, ".film small", "e.textContent.match(/^[\\d.]+ s, [\\d.]+ m$/)[0]")) == len(frames)


@pytest.mark.parametrize(("scheme", "width"), list(product(("light", "dark"), (375, 1280))))
def test_all_of_it_can_be_read(opened, scheme, width):
    page = opened(width, scheme)
    # No element is wider than the page: on a phone wide tables scroll in their own frame.
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    ((paper, ink),) = every(page, "body", "[getComputedStyle(e).backgroundColor, getComputedStyle(e).color]")
    assert paper == ("rgb(255, 255, 255)" if scheme == "light" else "rgb(20, 22, 26)")
    assert set(every(page, "figure svg text", "getComputedStyle(e).fill")) == {ink} != {paper}
    assert set(every(page, "td", "getComputedStyle(e).color")) == {ink}
    # Letters are legible without zooming.
    assert min(every(page, "figure svg text", "e.getBoundingClientRect().height")) >= 8
    assert min(every(page, "small, td, th, p", "parseFloat(getComputedStyle(e).fontSize)")) >= 11


@pytest.mark.parametrize("width", [1280, 1920])
def test_no_table_is_cut(opened, width):
    page = opened(width)
    tables = every(page, ".scroll", "[e.ariaLabel, e.scrollWidth - e.clientWidth]")
    assert len(tables) == 7 and [label for label, hidden in tables if hidden > 0] == []
    assert every(page, "[aria-label=Gaits] th", "e.textContent") == ["", *GROUPS]


@pytest.mark.parametrize("width", [390, 1280])
def test_a_sentence_stands_above_the_comparisons_and_the_rest_is_folded(opened, width):
    page = opened(width, unfolded=False)
    after = every(page, "#verdict ~ *", "e.className || e.tagName")[:4]
    assert after == ["short", "scroll lines", "note", "DETAILS"]
    said = page.locator(".short").inner_text()
    assert said == "In short: no difference shown in 24 comparisons."
    # Five groups against the first by four numbers; the time to the finish too, without the group of the stopped run.
    rows = every(page, ".lines tbody tr", "[...e.cells].map(cell => cell.innerText.split('\\n'))")
    assert len(rows) == 24 and {row[-1][0] for row in rows} == {"no difference shown, so few seeds cannot show one"}
    assert rows[0][0] == ["return", f"{GROUPS[0]} against {GROUPS[1]}"]
    assert rows[0][1][-2:] == ["+0.0", "(500.5 against 500.5)"] and "[500.0, 501.0]" in rows[0][2]
    assert page.locator(".lines").evaluate("e => e.scrollWidth - e.clientWidth") == 0
    sentence = page.get_by_text("seeds reach the finish in every episode").first
    assert not sentence.is_visible() and not page.locator("[aria-label=Runs]").is_visible()
    page.get_by_text(re.compile("^The whole verdict in words: ")).click()
    assert sentence.is_visible()
    page.get_by_text(re.compile("^Runs: 12 rows")).click()
    assert page.locator("[aria-label=Runs]").is_visible()


def test_a_runs_name_is_text(opened):
    page = opened(1280)
    assert NAME in every(page, "[aria-label=Runs] tr:last-child td:last-child", "e.textContent")


def test_a_metric_stands_with_its_unit_and_meaning(opened):
    page = opened(1280)
    rows = every(page, "[aria-label=Gaits] tbody tr", "[...e.cells].map(cell => cell.innerText)")
    said = {cells[0]: cells[1:] for cells in rows}
    for _, name, unit, _, meaning in GAIT:
        assert f"{name}{unit and ', '}{unit}\n{meaning}" in said
    (jerk,) = (cells for name, cells in said.items() if name.startswith("action jerk"))
    assert jerk == ["-48,950\n(-74,450 to -23,450)"] * len(GROUPS)
    (time,) = (cells for name, cells in said.items() if name.startswith("stride time"))
    assert time == ["0.80\n1 not periodic"] * len(GROUPS)


def test_the_first_column_stays_where_a_table_scrolls(opened):
    page = opened(375)
    gaits = "[aria-label=Gaits]"
    place = "e.getBoundingClientRect().left"
    before, cells = every(page, f"{gaits} tr > :first-child", place), every(page, f"{gaits} tr > :nth-child(2)", place)
    page.evaluate(f"document.querySelector('{gaits}').scrollLeft = 50")
    assert every(page, f"{gaits} tr > :first-child", place) == before
    assert every(page, f"{gaits} tr > :nth-child(2)", place) == [left - 50 for left in cells]


def test_right_and_left_are_told_apart(opened):
    page = opened(1280)
    for group in GROUPS[:2]:
        heading = page.get_by_role("heading", name=f"{group}, seed 0: phase portraits")
        drawn = page.locator("figure", has=heading).locator("text").all_text_contents()
        assert {"right", "left", "hip", "knee", "ankle"} <= set(drawn)
