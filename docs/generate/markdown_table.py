"""Write Markdown tables."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence


def table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> Iterator[str]:
    """Write the lines of a table."""
    yield line(heads)
    yield "|" + "---|" * len(heads)
    yield from map(line, rows)


def line(cells: Sequence[object]) -> str:
    """Write one line of a table."""
    return "| " + " | ".join(map(str, cells)) + " |"
