"""What the numbers show, in words: no more than the intervals allow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gctd3.reporting.runs import Run
from gctd3.reporting.statistics import FEW, Interval, improvement, interval

# What is compared: key, what it is called, unit, decimals, and what it is called to have more of it.
COMPARED = (
    ("return_mean", "return", "", 1, "returns more"),
    ("velocity_mean", "velocity", " m/s", 3, "is faster"),
    ("minutes_to_finish", "time to the first evaluation in which all finish", " min", 1, "takes longer"),
)


def scores(runs: Sequence[Run], key: str) -> list[float]:
    """A number of each run that has it."""
    values = [run.minutes_to_finish if key == "minutes_to_finish" else run.value(key) for run in runs]
    return [value for value in values if np.isfinite(value)]


def comparison(
    what: str,
    unit: str,
    digits: int,
    more: str,
    ours: tuple[str, Sequence[float]],
    theirs: tuple[str, Sequence[float]],
) -> str:
    """A sentence about one number of two groups of runs.

    Args:
        what: What is compared.
        unit: Of it, with a space before it.
        digits: Decimals.
        more: What it is to have more of it.
        ours: Name and numbers of the one group.
        theirs: Of the other.
    """
    (name, a), (other, b) = ours, theirs
    head = f"{name} and {other}, {what}"
    if not a or not b:
        nobody = " and ".join(group for group, values in (ours, theirs) if not values)
        return f"{head}: cannot be compared, {nobody} has no number for it."
    first, second = interval(a), interval(b)
    said = f"{_said(first, unit, digits, len(a))} against {_said(second, unit, digits, len(b))}"
    if len(a) < 2 or len(b) < 2:
        return f"{head}: no difference shown, a single seed cannot show one: {said}."
    chance = f"a run of {name} {more} than one of {other} with probability {improvement(a, b).text(2)}"
    if first.overlaps(second):
        return f"{head}: no difference shown, the intervals overlap: {said}; {chance}."
    return f"{head}: {name if first.value > second.value else other} {more}: {said}; {chance}."


def verdict(groups: Mapping[str, Sequence[Run]]) -> list[str]:
    """Sentences: what went wrong, then the first group against every other."""
    found = []
    for group, runs in groups.items():
        judged = [run for run in runs if run.evaluation is not None]
        walked = sum(run.value("success_rate") >= 1.0 for run in judged)
        lost = len(runs) - len(judged)
        line = f"{group}: {walked} of {len(runs)} seeds reach the finish in every episode"
        found.append(line + (f"; {lost} failed and have no numbers." if lost else "."))
    for group, runs in groups.items():
        for run in runs:
            if run.trouble:
                used = "its best policy until then counts" if run.evaluation is not None else "it has no policy"
                found.append(f"{group}, seed {run.seed} ({run.name}) {run.trouble.rstrip('.')}; {used}.")
    names = list(groups)
    for other in names[1:]:
        for key, what, unit, digits, more in COMPARED:
            pair = (names[0], scores(groups[names[0]], key)), (other, scores(groups[other], key))
            if pair[0][1] or pair[1][1]:
                found.append(comparison(what, unit, digits, more, *pair))
    never = [group for group, runs in groups.items() if len(scores(runs, "minutes_to_finish")) < len(runs)]
    if never and len(names) > 1:
        found.append(f"Times leave out the seeds that never finished, of which {', '.join(never)} has some.")
    if len(names) < 2:
        found.append("There is one kind of run only, so nothing is compared.")
    if any(len(scores(runs, "return_mean")) < FEW for runs in groups.values()):
        found.append(f"Some have fewer than {FEW} seeds: their intervals are rougher than they look.")
    return found


def _said(number: Interval, unit: str, digits: int, seeds: int) -> str:
    return f"{number.text(digits)}{unit} ({seeds} seed{'s' * (seeds != 1)})"
