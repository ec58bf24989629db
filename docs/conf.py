"""Configure the documentation site: ``python -m sphinx -W docs OUT`` (``pip install 'gctd3[docs]'``).

Sphinx, MyST and furo: docstrings are written in reStructuredText, pages in Markdown that a repository's host shows too,
and sphinx-autoapi reads the package without importing it, so that no PyTorch is needed. (Material for MkDocs, the other
candidate, ends in May 2027.)
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]

project = "gctd3"
author = "The gctd3 authors"
project_copyright = f"2026, {author}"  # as in LICENSE
version = release = re.findall(
    r'^__version__ = "(.*)"', (ROOT / "gctd3/__init__.py").read_text(encoding="utf-8"), re.M
)[0]

extensions = ["myst_parser", "sphinx.ext.napoleon", "autoapi.extension", "sphinx_copybutton"]
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = "gctd3"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sphinx = False
html_theme_options = {"top_of_page_buttons": []}
# Blocks without a language are command lines.
highlight_language = "bash"
pygments_style, pygments_dark_style = "friendly", "monokai"
smartquotes = False  # messages are quoted as they are
copybutton_exclude = ".linenos, .gp, .go"

myst_enable_extensions = ["deflist", "attrs_block", "colon_fence"]
myst_heading_anchors = 3
# Constants have comments instead of docstrings, and so no pages.
suppress_warnings = ["autoapi.python_import_resolution"]

autoapi_dirs = [str(ROOT / "gctd3")]
autoapi_root = "api"
autoapi_add_toctree_entry = False
autoapi_member_order = "bysource"
autoapi_python_class_content = "class"
autoapi_options = ["members", "show-inheritance", "show-module-summary"]
# Fields are in the class's own section.
napoleon_use_ivar = True
napoleon_google_docstring, napoleon_numpy_docstring = True, False
napoleon_custom_sections = [("Class attributes", "params_style"), ("Shapes", "notes_style")]

_LINK = re.compile(r"(?<!!)\[([^\]]*)\]\(\.\./([^)#]+)(?:#[^)]*)?\)")
_LISTED = re.compile(r"^```\{toctree\}\n(.*?)^```", re.M | re.S)


def _repository_links(app: Any, docname: str, source: list[str]) -> None:  # noqa: ANN401 - Sphinx is no dependency
    """Lead a link to a file of the repository to its page in the API reference, or else to the file itself."""

    def lead(match: re.Match[str]) -> str:
        text, path = match[1], ROOT / match[2]
        if match[2].startswith("gctd3/") and path.suffix == ".py":
            return f"[{text}](/api/{match[2].removesuffix('.py').removesuffix('/__init__')}/index.rst)"
        if path.is_dir():
            return text  # which names it; a site has no folders to show
        return f"[{text}](path:../{match[2]})"

    source[0] = _LINK.sub(lead, source[0])


def _unlisted_pages(app: Any, docname: str, source: list[str]) -> None:  # noqa: ANN401
    """Add the pages that the home page's tables of contents do not list to its last one."""
    if docname == "index":
        listed = {line.strip() for block in _LISTED.findall(source[0]) for line in block.splitlines()}
        more = sorted({file.stem for file in Path(app.srcdir).glob("*.md")} - listed - {"index"})
        place = source[0].rindex("```")
        source[0] = source[0][:place] + "".join(f"{page}\n" for page in more) + source[0][place:]


def setup(app: Any) -> dict[str, bool]:  # noqa: ANN401
    """Register what this file adds."""
    app.connect("source-read", _repository_links)
    app.connect("source-read", _unlisted_pages)
    return {"parallel_read_safe": True}
