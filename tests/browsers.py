"""Start a headless Chromium for tests of pages; without Playwright or Chromium they are skipped."""

import contextlib
import shutil

import pytest

api = pytest.importorskip("playwright.sync_api", reason="no Playwright")
PROGRAM = next(filter(None, map(shutil.which, ("chromium-headless-shell", "chromium", "google-chrome"))), None)
if PROGRAM is None:
    pytest.skip("no Chromium", allow_module_level=True)
# WebGL without a GPU.
SOFTWARE = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


@contextlib.contextmanager
def chromium():
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=PROGRAM, args=["--no-sandbox", *SOFTWARE])
        yield browser
        browser.close()
