"""The documentation is whole: links, tables, commands and messages are true; the site is built without a warning."""

import html.parser
import importlib
import importlib.util
import json
import re
import shlex
import urllib.parse
from pathlib import Path

import pytest
from hydra import compose, initialize_config_module
from hydra.core.override_parser.overrides_parser import OverridesParser
from thinned import parametrize

from gctd3.config.help import COMMANDS, root_of

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.glob("*.md"))]
FENCED = re.compile(r"^```([^\n`]*)\n(.*?)^```", re.M | re.S)


def text_of(page):
    return page.read_text(encoding="utf-8")


def anchors(page):
    """Return the anchors of a page's headings, as repositories' hosts and MyST make them."""
    heads = re.findall(r"^#+ (.+)$", FENCED.sub("", text_of(page)), flags=re.M)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    links = re.findall(r"\]\((?!https?:)([^)\s]+)\)", FENCED.sub("", text_of(page)))
    for link in links:
        path, _, anchor = link.partition("#")
        # The API reference is made when the site is built.
        target = (page.parent / path).resolve() if path else page
        assert target.exists() or path == "api/gctd3/index.rst", link
        assert not anchor or anchor in anchors(target), link


def test_readme_is_a_door():
    linked = set(re.findall(r"\]\(docs/([\w-]+\.md)", text_of(ROOT / "README.md")))
    linked |= set(re.findall(r"\]\(([\w-]+\.md)", text_of(DOCS / "index.md")))
    # Pages that neither names are found in the site's contents.
    assert len(linked) >= 12
    assert text_of(ROOT / "README.md").count("\n") <= 130


@pytest.fixture
def page_tables(monkeypatch):
    monkeypatch.syspath_prepend(str(DOCS / "generate"))
    return importlib.import_module("page_tables")


def test_tables_are_as_python_docs_generate_writes_them(page_tables):
    places = 0
    for page in page_tables.PAGES:
        text = text_of(page)
        places += text.count("<!-- table: ")
        assert text.count("<!-- table: ") == text.count("<!-- end -->")
        assert page_tables.rewritten(text) == text, f"{page.name} differs: run python docs/generate"
    assert places >= len(page_tables.TABLES)


def test_a_changed_table_is_written_anew(page_tables):
    text = text_of(DOCS / "tasks.md")
    assert "| `velocity` | `ForwardVelocity` | **1**" in text
    assert page_tables.rewritten(text.replace("**1**", "**2**")) == text


def test_messages_of_the_troubleshooting_exist():
    source = " ".join(text_of(file) for file in (ROOT / "gctd3").rglob("*.py"))
    # A message that goes over several lines of the source, and its numbers.
    source = re.sub(r'"\s*\n\s*f?"', "", source).replace("{group}/{option}", "algo/")
    messages = re.findall(r'^\| "([^"]+)"', text_of(DOCS / "troubleshooting.md"), flags=re.M)
    assert len(messages) >= 20
    for message in messages:
        assert message in source, message


# Every command that is shown, in blocks, in running text and in tables, with what its overrides say.


def shown():
    """Return every command of gctd3 in README and the pages, as words."""
    found = {}
    for page in PAGES:
        text = text_of(page)
        blocks = "".join(inside for language, inside in FENCED.findall(text) if not language)
        lines = [part.strip() for line in blocks.splitlines() for part in line.split("&&")]
        lines += re.findall(r"`((?:python -m gctd3\.|gctd3-)[a-z][^`\n]*)`", FENCED.sub("", text))
        for line in lines:
            line = line.replace("gctd3-", "python -m gctd3.") if line.startswith("gctd3-") else line
            if line.startswith("python -m gctd3."):
                words = shlex.split(line)
                found[" ".join(words[2:])] = words
    return found


SHOWN = shown()
OTHER_MODULES = {"gctd3.config.reference"}


@pytest.fixture
def hydras(tmp_path):
    """Make the folder of a YAML of one's own that a page shows."""
    (mine,) = (inside for language, inside in FENCED.findall(text_of(DOCS / "your-robot.md")) if language == "yaml")
    (tmp_path / "robots/robot").mkdir(parents=True)
    (tmp_path / "robots/robot/mine.yaml").write_text(mine)
    return tmp_path


@parametrize(6, "line", sorted(SHOWN))
def test_a_shown_command_composes(line, hydras):
    _, _, module, *arguments = SHOWN[line]
    name = module.removeprefix("gctd3.")
    if module in OTHER_MODULES:
        assert importlib.util.find_spec(module) is not None and arguments[:1] in ([], [">"])
        return
    assert name in COMMANDS
    path = [word.partition("=")[2] for word in arguments if word.startswith("--config-dir=")]
    # A file's robot has the settings of a free base.
    arguments = [re.sub(r"^robot=(?=.+\.(xml|urdf)$)", "robot.name=", one) for one in arguments if one[0] != "-"]
    for overrides in spread(arguments):
        if path:
            overrides = [*overrides, f"hydra.searchpath=[file://{hydras / path[0]}]"]
        with initialize_config_module("gctd3.conf", version_base="1.3"):
            config = compose(root_of(name), overrides, return_hydra_config=bool(path))
        assert "_target_" in config


def spread(arguments):
    """Yield the overrides of a sweep, each of its values once, without those of launchers, which are plug-ins."""
    parsed = OverridesParser.create().parse_overrides([one for one in arguments if not one.startswith("hydra")])
    values = [list(one.sweep_string_iterator()) if one.is_sweep_override() else None for one in parsed]
    for place in range(max((len(each) for each in values if each), default=1)):
        yield [
            one.input_line if each is None else f"{one.get_key_element()}={each[min(place, len(each) - 1)]}"
            for one, each in zip(parsed, values, strict=True)
        ]


def test_commands_were_found():
    assert len(SHOWN) >= 30
    assert any(line.startswith("gctd3.report") for line in SHOWN) and any(
        "experiment=table5 " in line for line in SHOWN
    )


def test_a_wrong_command_is_found(hydras, monkeypatch):
    monkeypatch.setitem(SHOWN, "wrong", ["python", "-m", "gctd3.train", "algo=gctd3,td4"])
    with pytest.raises(Exception, match="td4"):
        test_a_shown_command_composes("wrong", hydras)


# The site.


class Names(html.parser.HTMLParser):
    """Collect the links and the anchors of a page of HTML."""

    def __init__(self, page):
        super().__init__()
        self.links, self.anchors = [], set()
        self.feed(text_of(page))

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.links += [given[key] for key in ("href", "src") if given.get(key)]
        self.anchors |= {given[key] for key in ("id", "name") if given.get(key)}


@pytest.mark.nightly
def test_the_site_is_built_without_warnings_and_its_links_lead_somewhere(site):
    pages = {page: Names(page) for page in site.rglob("*.html")}
    assert len(pages) > 100 and (site / "api/gctd3/nn/graph_conv/index.html") in pages
    broken = []
    for page, names in pages.items():
        for link in names.links:
            parts = urllib.parse.urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (page.parent / urllib.parse.unquote(parts.path)).resolve() if parts.path else page
            lost = target in pages and parts.fragment and parts.fragment not in pages[target].anchors
            if not target.exists() or lost:
                broken.append(f"{page.relative_to(site)}: {link}")
    assert not broken, "\n".join(broken[:20])
    # What is searched for is found.
    assert "mirror" in json.dumps((site / "searchindex.js").read_text(encoding="utf-8"))
