"""Cells of tables: a text for the page, and plain numbers for CSV files."""

import csv
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rliable")
from gctd3.comparison.cells import Cell, columns_of_numbers, count, estimate, mean, mean_and_range, number, spread
from gctd3.comparison.statistics import Interval
from gctd3.comparison.tables import Table

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results"


@pytest.mark.parametrize(
    ("cell", "text", "numbers"),
    [
        (number(-48950.4, 0), "-48,950", {"value": "-48950"}),
        (number(np.nan, 1), "-", {}),
        (mean([1.0, 2.0], 2), "1.50", {"value": "1.50"}),
        (mean([], 2), "-", {}),
        (spread([1.0, 3.0], 1), "2.0 ± 1.4", {"value": "2.0", "sd": "1.4"}),
        (spread([1.0], 1), "1.0", {"value": "1.0"}),
        (estimate(Interval(5.0, 4.0, 6.0), 1), "5.0 [4.0, 6.0]", {"value": "5.0", "low": "4.0", "high": "6.0"}),
        (estimate(Interval(5.0, np.nan, np.nan), 1), "5.0", {"value": "5.0"}),
        (estimate(Interval(np.nan, np.nan, np.nan), 1), "undefined", {}),
        (
            mean_and_range([1000.0, 3000.0], 0),
            "2,000 (1,000 to 3,000)",
            {"value": "2000", "low": "1000", "high": "3000"},
        ),
        (count(2, 3), "2 of 3", {"value": "2", "of": "3"}),
    ],
)
def test_text_and_numbers(cell, text, numbers):
    assert cell == text and cell.numbers == numbers


def test_every_number_gets_a_column():
    rows = [
        ["ours", spread([1.0, 3.0], 1), Cell("undefined"), "words"],
        ["paper", "-", number(1234.0, 0), "5.0"],
    ]
    assert columns_of_numbers(["", "return, mean ± sd", "frames", "what"], rows) == [
        ["", "return, mean", "return, mean, sd", "frames", "frames, note", "what"],
        ["ours", "2.0", "1.4", "", "undefined", "words"],
        ["paper", "", "", "1234", "", "5.0"],
    ]
    assert columns_of_numbers(["a", "b"], []) == [["a", "b"]]
    table = Table("name", "Title", "", ["", "frames"], [["x", number(1234.0, 0)]])
    assert table.csv() == ",frames\nx,1234\n"


@pytest.mark.parametrize(
    "file", sorted(RESULTS.glob("*/tables/*.csv")), ids=lambda file: f"{file.parts[-3]}-{file.stem}"
)
def test_numbers_of_committed_reports_are_numbers(file):
    """In a column in which one cell is a number, all are, or empty; configurations hold texts beside numbers."""
    with file.open(encoding="utf-8") as opened:
        rows = list(csv.DictReader(opened))
    assert rows
    numeric = {name for name in rows[0] if any(is_number(row[name]) for row in rows)}
    if file.stem == "settings":
        return
    assert numeric and all(row[name] == "" or is_number(row[name]) for row in rows for name in numeric)
    assert not any(mark in row[name] for row in rows for name in row for mark in ("±", " ["))


def is_number(text):
    try:
        float(text)
    except ValueError:
        return False
    return True
