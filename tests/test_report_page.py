"""The report's page in a browser, where there is one: offline, narrow and wide, light and dark."""

import pytest
from browsers import chromium
from test_report import examined, make

pytest.importorskip("rliable")


@pytest.fixture(scope="module")
def page_file(tmp_path_factory):
    from gctd3.report import ReportSettings, report

    root = tmp_path_factory.mktemp("report")
    for seed in range(3):
        examined(make(root / "runs", f"a{seed}", 500.0 + seed), 0.8, [2.0, 4.0])
        make(root / "runs", f"b{seed}", 400.0 + seed, overrides=["algo=td3"], change={"algo.tau": 0.01})
    return report(ReportSettings(str(root / "runs"), str(root / "out")))


@pytest.fixture(scope="module")
def browser():
    with chromium() as opened:
        yield opened


@pytest.mark.parametrize("width", [360, 1280])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_page_opens_from_the_disk(browser, page_file, width, scheme):
    context = browser.new_context(viewport={"width": width, "height": 800}, color_scheme=scheme, offline=True)
    page, said, asked = context.new_page(), [], []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(page_file.resolve().as_uri())
    assert said == [] and all(url.startswith("file:") for url in asked) and len(asked) == 1
    # Nothing sticks out: wide tables scroll in their own frame.
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    colour = "getComputedStyle(document.querySelector('{}')).{}"
    paper = page.evaluate(colour.format("body", "backgroundColor"))
    assert paper == ("rgb(255, 255, 255)" if scheme == "light" else "rgb(20, 22, 26)")
    ink = page.evaluate(colour.format("body", "color"))
    assert page.evaluate(colour.format("figure svg text", "fill")) == ink != paper
    # Letters of figures are legible without zooming.
    height = "Math.min(...[...document.querySelectorAll('figure svg text')].map(t => t.getBoundingClientRect().height))"
    assert page.evaluate(height) >= 8
    context.close()
