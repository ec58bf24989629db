"""The report's table of gaits: every metric with its definition, by group."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from gctd3.comparison.cells import Cell, count, mean_and_range
from gctd3.comparison.runs import Run
from gctd3.comparison.tables import MEANING, UNIT, Table
from gctd3.comparison.verdict import scores
from gctd3.evaluation.gait_metrics import circular_mean
from gctd3.evaluation.quantities import ASYMMETRY, QUANTITIES, SINGLE, TOUCHDOWNS, quantity
from gctd3.evaluation.summary import why_missing

# Without what only conditions of trainings read, and what the others add up to.
GAIT = tuple(known for known in QUANTITIES if known.key not in (TOUCHDOWNS, SINGLE))


def gaits(groups: Mapping[str, Sequence[Run]]) -> Table:
    """Return the table of gait metrics with their definitions: mean, lowest and highest over seeds; no empty rows."""
    keys = sorted({key for runs in groups.values() for run in runs for key in run.gait if key.startswith(ASYMMETRY)})
    joints = [quantity(key) for key in keys]
    counts = [count(sum(bool(run.gait) for run in runs), len(runs)) for runs in groups.values()]
    evaluated = ["seeds evaluated here", "", *counts, "seeds with an episode that got 10 m far"]
    rows = []
    for key, name, unit, digits, meaning in (*GAIT, *joints):
        cells = [_gait_cell(runs, key, digits) for runs in groups.values()]
        if any(cell != "-" for cell in cells):
            rows.append([name, unit, *cells, meaning])
    return Table(
        "gait",
        "Gaits",
        "Over the last 10 m of the episodes that got that far: mean over seeds (lowest to highest). Metrics of strides "
        "cover the seeds with strides in at least half of these episodes.",
        ("", UNIT, *groups, MEANING),
        [evaluated, *rows] if rows else [],
    )


def _gait_cell(runs: Sequence[Run], key: str, digits: int) -> Cell:
    """Return a metric's mean over seeds and range, and how many seeds lack it, with the reason."""
    known = scores(runs, key)
    if key == "phase_offset" and known:
        # Phases go round: 0.98 and 0.02 are neighbours.
        mean = circular_mean(known)
        known = [mean + (phase - mean + 0.5) % 1.0 - 0.5 for phase in known]
    gaits = [run.gait for run in runs]
    lacking = Counter(why_missing(gait, key) for gait in gaits if key in gait and gait[key] is None)
    reasons = [f"{seeds} {why}" for why, seeds in lacking.items()]
    cell = mean_and_range(known, digits)
    if not reasons:
        return cell
    return Cell("; ".join([*([cell] if known else []), *reasons]), {**cell.numbers, "lacking": "; ".join(reasons)})
