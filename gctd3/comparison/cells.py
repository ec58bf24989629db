"""Cells of the report's tables: a text for the page, and the numbers in it for CSV files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gctd3.comparison.statistics import Interval

VALUE, ENDS = "value", ("low", "high")


class Cell(str):
    """Hold a cell's text, with the numbers in it as plain decimals by name; ``value`` is the main one.

    Args:
        text: Text for the page.
        numbers: Numbers by name, each a decimal without separators, as ``{"value": "501.0", "sd": "1.0"}``.
    """

    numbers: Mapping[str, str]

    def __new__(cls, text: str, numbers: Mapping[str, str] | None = None) -> Cell:
        """Create the text and keep its numbers beside it."""
        made = super().__new__(cls, text)
        made.numbers = numbers or {}
        return made


def number(value: float, digits: int) -> Cell:
    """Format a number with separators of thousands; ``-`` if it is not finite."""
    return Cell(f"{value:,.{digits}f}", {VALUE: f"{value:.{digits}f}"}) if np.isfinite(value) else Cell("-")


def mean(values: Sequence[float], digits: int) -> Cell:
    """Format the mean; ``-`` without values."""
    return _plain(f"{np.mean(values):.{digits}f}") if len(values) else Cell("-")


def spread(values: Sequence[float], digits: int) -> Cell:
    """Format mean and standard deviation as ``501.0 ± 1.0``; ``-`` without values."""
    if len(values) < 2:
        return mean(values, digits)
    return mean_and_sd(f"{np.mean(values):.{digits}f}", f"{np.std(values, ddof=1):.{digits}f}")


def mean_and_sd(value: str, deviation: str) -> Cell:
    """Join a mean and a standard deviation, both formatted, as ``501.0 ± 1.0``."""
    return Cell(f"{value} ± {deviation}", {VALUE: value, "sd": deviation})


def estimate(interval: Interval, digits: int) -> Cell:
    """Format an estimate with its interval as ``501.0 [500.0, 502.0]``."""
    return Cell(interval.text(digits), estimate_numbers(interval, digits))


def estimate_numbers(interval: Interval, digits: int) -> dict[str, str]:
    """Return the numbers of an estimate: ``value``, ``low`` and ``high``, without those that are not finite."""
    ends = zip((VALUE, *ENDS), (interval.value, interval.low, interval.high), strict=True)
    return {name: f"{value:.{digits}f}" for name, value in ends if np.isfinite(value)}


def mean_and_range(values: Sequence[float], digits: int) -> Cell:
    """Format mean and range as ``0.50 (0.40 to 0.60)``; ``-`` without values."""
    if len(values) < 2:
        return number(float(np.mean(values)), digits) if len(values) else Cell("-")
    middle, low, high = (number(float(value), digits) for value in (np.mean(values), min(values), max(values)))
    numbers = {VALUE: middle.numbers[VALUE], "low": low.numbers[VALUE], "high": high.numbers[VALUE]}
    return Cell(f"{middle} ({low} to {high})", numbers)


def count(some: int, of: int) -> Cell:
    """Format how many of all there are, as ``2 of 3``."""
    return Cell(f"{some} of {of}", {VALUE: str(some), "of": str(of)})


def _plain(text: str) -> Cell:
    return Cell(text, {VALUE: text})


def columns_of_numbers(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[list[str]]:
    """Return head and rows of a CSV file: a column for each number, empty where a cell lacks it.

    A column without numbers stays as it is. In one with numbers, a cell without any is a text and gets a column of its
    own, ``note``, unless it is ``-``.
    """
    columns: list[list[str]] = []
    for title, cells in zip(head, zip(*rows, strict=True) if rows else [()] * len(head), strict=True):
        parts = [cell.numbers if isinstance(cell, Cell) else {} for cell in cells]
        names = list(dict.fromkeys(name for part in parts for name in part))
        if not names:
            columns.append([title, *cells])
            continue
        base = title.removesuffix(" ± sd")
        titles = [base if name == VALUE else f"{base}, {name}" for name in names]
        columns += [[title, *(part.get(name, "") for part in parts)] for title, name in zip(titles, names, strict=True)]
        notes = ["" if part or cell == "-" else str(cell) for cell, part in zip(cells, parts, strict=True)]
        if any(notes):
            columns.append([f"{base}, note", *notes])
    return [list(row) for row in zip(*columns, strict=True)]
