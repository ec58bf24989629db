"""Fill the tables of the documentation's pages from code, YAML and results, so that they cannot differ from these.

A page marks the place of a table by a comment with its name; ``python docs/generate`` writes what stands between that
and ``<!-- end -->``. ``docs/configuration.md`` is written by ``python -m gctd3.config.reference``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import Path

import name_tables
import result_tables
import robot_tables
import task_tables

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
TABLES: dict[str, Callable[[], Iterable[str]]] = {
    **task_tables.TABLES,
    **robot_tables.TABLES,
    **result_tables.TABLES,
    **name_tables.TABLES,
}
_PLACE = re.compile(r"(<!-- table: ([\w-]+) -->\n).*?(<!-- end -->)", re.S)


def rewritten(text: str) -> str:
    """Return a page with its tables written anew."""
    return _PLACE.sub(lambda place: place[1] + "\n" + "\n".join([*TABLES[place[2]]()]) + "\n\n" + place[3], text)
