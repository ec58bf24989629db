"""Start a headless Chromium for tests of pages; without Playwright or Chromium they are skipped."""

import contextlib
import importlib
import importlib.util
import shutil

import pytest

if importlib.util.find_spec("playwright") is None:
    pytest.skip("no Playwright", allow_module_level=True)
PROGRAM = next(filter(None, map(shutil.which, ("chromium-headless-shell", "chromium", "google-chrome"))), None)
if PROGRAM is None:
    pytest.skip("no Chromium", allow_module_level=True)
# WebGL without a GPU.
SOFTWARE = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


@contextlib.contextmanager
def chromium(*more):
    # Imported where a page is opened: collecting the tests would wait for it.
    with importlib.import_module("playwright.sync_api").sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=PROGRAM, args=["--no-sandbox", *SOFTWARE, *more])
        yield browser
        browser.close()
