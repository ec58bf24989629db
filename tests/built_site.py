"""Build the documentation site once a session, for the tests of its pages."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest
from finished import once

DOCS = Path(__file__).parents[1] / "docs"
NEEDED = ("sphinx", "myst_parser", "furo", "autoapi", "sphinx_copybutton")


def built_site(folder):
    """Return the folder of the site, built below ``folder``; a warning is an error."""
    if not all(map(importlib.util.find_spec, NEEDED)):
        pytest.skip("no Sphinx: pip install 'gctd3[docs]'")

    def build(out):
        call = [sys.executable, "-W", "ignore", "-m", "sphinx", "-q", "-W", "--keep-going", str(DOCS), str(out)]
        built = subprocess.run(call, capture_output=True, text=True)
        assert built.returncode == 0 and not built.stderr, built.stderr

    return once(folder, build)
