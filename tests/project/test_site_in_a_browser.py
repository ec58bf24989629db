"""The site's pages fit a telephone and a desk, in light and dark, in a real browser."""

import pytest
from browsers import chromium

pytestmark = pytest.mark.nightly
# What is wider than the page has a scroll bar of its own.
WIDER = """() => [...document.querySelectorAll('article *')].filter(
    e => e.getBoundingClientRect().right > innerWidth + 1 && !e.closest('.table-wrapper, pre, .highlight')
).map(e => e.tagName + ' ' + e.textContent.slice(0, 60))"""
OVERFLOW = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
MISSING = "[...document.images].filter(image => !image.naturalWidth).map(image => image.src)"
# The colours of text and page, as a browser computes them.
COLOURS = (
    "[getComputedStyle(document.querySelector('article p')).color, getComputedStyle(document.body).backgroundColor]"
)


def luminance(colour):
    """Return the relative luminance of ``rgb(r, g, b)`` (WCAG 2.2)."""
    numbers = [int(part) / 255 for part in colour.partition("(")[2].rstrip(")").split(",")[:3]]
    red, green, blue = (n / 12.92 if n <= 0.04045 else ((n + 0.055) / 1.055) ** 2.4 for n in numbers)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


@pytest.mark.parametrize("width", [390, 1280])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_pages_fit_and_can_be_read(site, width, scheme):
    pages = [*sorted(site.glob("*.html")), site / "api/gctd3/robots/graph/index.html"]
    assert len(pages) >= 15
    with chromium() as browser:
        page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
        for file in pages:
            page.goto(file.as_uri())
            assert page.evaluate(OVERFLOW) <= 0, file.name
            assert page.evaluate(WIDER) == [], file.name
            assert page.evaluate(MISSING) == [], file.name
        page.goto((site / "concepts.html").as_uri())
        ink, paper = map(luminance, page.evaluate(COLOURS))
        assert (paper > ink) is (scheme == "light")
        assert (max(ink, paper) + 0.05) / (min(ink, paper) + 0.05) >= 7
        page.close()
