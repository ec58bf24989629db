"""The report's HTML page, which opens from the disk, on a phone and on a screen, in light and in dark."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from gctd3.comparison.figures import Picture
from gctd3.comparison.tables import DIRECTORY, FINDING, MEANING, OUTCOME, UNIT, Table
from gctd3.comparison.verdict import NOTHING

CSS = """
:root { color-scheme: light dark; --paper: #ffffff; --ink: #1c1f24; --soft: #5c6470; --line: #d8dce2; --card: #f6f7f9; }
@media (prefers-color-scheme: dark) {
  :root { --paper: #14161a; --ink: #e6e8ec; --soft: #a0a8b4; --line: #343a44; --card: #1c1f25; }
}
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 76rem; padding: 1rem; background: var(--paper); color: var(--ink);
  font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, Helvetica, Arial, sans-serif; }
h1 { font-size: 1.6rem; line-height: 1.2; margin: 0.5rem 0; }
h2 { font-size: 1.2rem; margin: 2.2rem 0 0.6rem; }
h3 { font-size: 1rem; margin: 0 0 0.4rem; overflow-wrap: anywhere; }
p, figcaption, .note { color: var(--soft); margin: 0.4rem 0; }
figcaption, .note { font-size: 0.85rem; }
nav { font-size: 0.9rem; } nav a { color: inherit; margin-right: 0.9rem; display: inline-block; }
p.short { font-size: 1.1rem; color: var(--ink); margin: 0.4rem 0 0.9rem; }
details { margin: 0.8rem 0; } summary { cursor: pointer; padding: 0.25rem 0; }
details > .scroll, details > ul { margin-top: 0.5rem; }
ul.verdict { padding: 0.8rem 1rem 0.8rem 2rem; background: var(--card); border: 1px solid var(--line);
  border-radius: 8px; } ul.verdict li { margin: 0.35rem 0; }
.grid { display: grid; gap: 1rem; align-items: start;
  grid-template-columns: repeat(auto-fit, minmax(min(100%, 21rem), 1fr)); }
.row, .note + .grid { margin-top: 1rem; } .column { display: grid; gap: 1rem; align-content: start; }
.row { grid-template-columns: repeat(auto-fill, minmax(min(100%, 21rem), 1fr)); } .wide { grid-column: 1 / -1; }
figure { margin: 0; padding: 0.8rem; background: var(--card); border: 1px solid var(--line); border-radius: 8px; }
figure svg, figure img { display: block; width: 100%; height: auto; color: var(--ink); }
figure img { border-radius: 4px; }
.film { display: grid; gap: 0.4rem; grid-template-columns: repeat(8, 1fr); }
@media (max-width: 60rem) { .film { grid-template-columns: repeat(4, 1fr); } }
@media (max-width: 40rem) { .film { grid-template-columns: repeat(2, 1fr); } }
.scroll { overflow-x: auto; border: 1px solid var(--line); border-radius: 8px; }
table { border-collapse: collapse; width: 100%; font-size: 0.875rem; font-variant-numeric: tabular-nums; }
small { display: block; color: var(--soft); }
th, td { text-align: left; padding: 0.35rem 0.5rem; border-bottom: 1px solid var(--line); vertical-align: top; }
th { background: var(--card); font-weight: 600; vertical-align: bottom; } tr:last-child td { border-bottom: 0; }
th:first-child, td:first-child { position: sticky; left: 0; min-width: 8.5rem; }
td:first-child { background: var(--paper); } td:first-child.meant { min-width: 14rem; }
td.number { white-space: nowrap; } td.long { min-width: 11rem; }
@media (max-width: 40rem) { td:first-child.meant { min-width: 9.5rem; }
  /* Comparisons: on a phone a block for each, with the names of its numbers, in place of a table that scrolls. */
  .lines thead { display: none; } .lines table, .lines tbody { display: block; }
  .lines tr { display: grid; padding: 0.5rem 0.6rem; gap: 0 0.4rem;
    grid-template-columns: minmax(0, 1.25fr) minmax(0, 1.1fr) minmax(0, 0.8fr);
    border-bottom: 1px solid var(--line); }
  .lines td, .lines td:first-child.meant { min-width: 0; padding: 0.15rem 0; border: 0; position: static; }
  .lines td:first-child, .lines td.long { grid-column: 1 / -1; } .lines td:first-child { font-weight: 600; }
  .lines small { font-weight: 400; } .lines td.number { white-space: normal; }
  .lines td.number::before { content: attr(data-name); display: block; color: var(--soft); font-size: 0.75rem; } }
"""
# Sections that are folded: what they hold is looked up, not read.
FOLDED = ("Runs", "Settings")


@dataclass(frozen=True)
class Row:
    """Hold pictures that belong together, shown side by side where the page is wide enough.

    Attributes:
        columns: Columns of pictures, each from top to bottom.
        wide: Pictures above the columns, as wide as the page.
    """

    columns: Sequence[Sequence[Picture]]
    wide: Sequence[Picture] = ()


def page(
    title: str,
    about: str,
    sentences: Sequence[str],
    sections: Sequence[tuple[str, Sequence[object]]],
    compared: Table | None = None,
) -> str:
    """Return the page's HTML: the first sentence, the comparisons, the other sentences folded, and the sections.

    Args:
        title: Title of the page.
        about: Line below the title.
        sentences: Sentences of the verdict.
        sections: Heading of each section, and the pictures, tables and notes in it.
        compared: Table of the comparisons, if there are any.
    """
    links = "".join(f'<a href="#{_anchor(name)}">{escape(name)}</a>' for name, things in sections if things)
    first, *others = sentences
    told = f'<ul class="verdict">{"".join(map(_sentence, others))}</ul>'
    rest = _fold(f"The whole verdict in words: {len(others)} more sentence{'s' * (len(others) != 1)}", told)
    verdict = f'<p class="short"><strong>{escape(first)}</strong></p>'
    verdict += _table(compared, "scroll lines") if compared is not None else ""
    verdict += rest if others else ""
    body = "".join(_section(name, things) for name, things in sections if things)
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{CSS}</style></head>\n<body>"
        f'<h1>{escape(title)}</h1><p>{escape(about)}</p><nav>{links}</nav>\n<h2 id="verdict">Verdict</h2>'
        f"{verdict}\n{body}</body></html>\n"
    )


def _section(name: str, things: Sequence[object]) -> str:
    pictures = [thing for thing in things if isinstance(thing, Picture)]
    tables = [thing for thing in things if isinstance(thing, Table)]
    rows = "".join(_row(thing) for thing in things if isinstance(thing, Row))
    notes = "".join(f'<p class="note">{escape(thing)}</p>\n' for thing in things if isinstance(thing, str))
    drawn = "".join(map(_figure, pictures))
    grid = f'<div class="grid">{drawn}</div>' if drawn else ""
    content = f"{''.join(map(_table, tables))}{notes}{grid}{rows}"
    if name in FOLDED:
        content = _fold("; ".join(f"{thing.title}: {len(thing.rows)} rows" for thing in tables), content)
    return f'<h2 id="{_anchor(name)}">{escape(name)}</h2>\n{content}\n'


def _fold(summary: str, content: str) -> str:
    return f"<details><summary>{escape(summary)}</summary>{content}</details>\n"


def _row(row: Row) -> str:
    parts = [("column wide", row.wide), *(("column", column) for column in row.columns)]
    drawn = "".join(
        f'<div class="{kind}">{"".join(map(_figure, pictures))}</div>' for kind, pictures in parts if pictures
    )
    return f'<div class="grid row">{drawn}</div>\n' if drawn else ""


def _figure(picture: Picture) -> str:
    caption = f"<figcaption>{escape(picture.caption)}</figcaption>" if picture.caption else ""
    return f"<figure><h3>{escape(picture.title)}</h3>{picture.body}{caption}</figure>\n"


def _table(table: Table, kind: str = "scroll") -> str:
    head = "".join(f"<th>{_breakable(cell)}</th>" for cell in table.head if cell not in (UNIT, MEANING))
    rows = "".join(_table_row(dict(zip(table.head, row, strict=True))) for row in table.rows)
    return (
        f'<div class="{kind}" tabindex="0" role="region" aria-label="{escape(table.title)}"><table>'
        f'<thead><tr>{head}</tr></thead><tbody>\n{rows}</tbody></table></div><p class="note">{escape(table.note)}</p>\n'
    )


def _table_row(cells: dict[str, str]) -> str:
    """Return a table row with unit and meaning in the cell of its name, which leaves room for the numbers."""
    unit, meaning = cells.pop(UNIT, ""), cells.pop(MEANING, "")
    (_, name), *others = cells.items()
    named = _breakable(f"{name}, {unit}" if unit else name)
    first = f'<td class="meant">{named}<small>{escape(meaning)}</small></td>' if meaning else f"<td>{named}</td>"
    return f"<tr>{first}{''.join(_cell(column, text) for column, text in others)}</tr>\n"


def _cell(column: str, text: str) -> str:
    if column == FINDING and NOTHING not in text:
        return f'<td class="long"><strong>{_breakable(text)}</strong></td>'
    if column in (OUTCOME, DIRECTORY, FINDING):
        return f'<td class="long">{_breakable(text)}</td>'
    if not re.match(r"[-+[]?\d", text):
        return f"<td>{_breakable(text)}</td>"
    # The estimate comes first; its range and the number of seeds that lack it get lines of their own.
    estimate, *more = text.split("; ")
    split = re.fullmatch(r"(\S+) ([(\[].*)", estimate)
    estimate, *more = [*split.groups(), *more] if split else [estimate, *more]
    lines = "".join(f"<small>{escape(line)}</small>" for line in more)
    return f'<td class="number" data-name="{escape(column)}">{escape(estimate)}{lines}</td>'


def _breakable(text: str) -> str:
    """Escape a text for HTML, and allow line breaks between the words of long names."""
    return re.sub(r"(?<=[A-Za-z\d])([./_=,])(?=[A-Za-z])", r"\1<wbr>", escape(text))


def _sentence(text: str) -> str:
    """Return a sentence as a list item with its finding in bold and the numbers behind it plain."""
    parts = text.split(": ", 2)
    if len(parts) < 3 or NOTHING in parts[1]:
        return f"<li>{escape(text)}</li>"
    return f"<li><strong>{escape(': '.join(parts[:2]))}</strong>: {escape(parts[2])}</li>"


def _anchor(name: str) -> str:
    return "".join(letter if letter.isalnum() else "-" for letter in name.lower())
