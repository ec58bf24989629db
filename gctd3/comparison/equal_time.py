"""Results of runs at equal wall-clock time, as if a time limit had ended them there."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from gctd3.comparison.runs import Run

# Ratio of the times for the same work, above which something else must have slowed a run down.
SPREAD = 1.2


@dataclass(frozen=True)
class Limit:
    """Represent the wall-clock time at which groups are compared.

    Attributes:
        seconds: Wall-clock time since a training's beginning (s).
        group: Name of the group whose trainings take that long in the median.
        medians: Training time of each group (s), the median of its runs that came to their end; NaN if none did.
    """

    seconds: float
    group: str
    medians: Mapping[str, float]

    @property
    def text(self) -> str:
        """Return the time as ``3.2 min``."""
        return duration(self.seconds)


@dataclass(frozen=True)
class Reached:
    """Hold the results that a run had reached at a time.

    Attributes:
        return_mean: Mean return of the policy that it would have kept.
        success_rate: Success rate in the same evaluation; NaN if it is unknown.
        frames: Frames collected by then.
        updates: Updates done by then.
    """

    return_mean: float
    success_rate: float
    frames: float
    updates: float


def duration(seconds: float) -> str:
    """Format a time as ``3.2 min``, or ``3.2 s`` below a minute."""
    return f"{seconds / 60.0:.1f} min" if seconds >= 60.0 else f"{seconds:.1f} s"


def whole_times(runs: Sequence[Run]) -> list[float]:
    """Return the training times (s) of the runs that came to their end."""
    return [60.0 * run.minutes for run in runs if not run.trouble and math.isfinite(run.minutes)]


def uneven(groups: Mapping[str, Sequence[Run]]) -> list[str]:
    """List groups with two runs whose times for the same frames differ by a factor above ``SPREAD``, with these times.

    Their configurations are the same, so the machine caused it: its threads, another program, or a pause.
    """
    lines = []
    for group, runs in groups.items():
        apart = [_same_work(*pair) for pair in combinations([run for run in runs if not run.trouble], 2)]
        known = [(slow / fast, fast, slow, frames) for fast, slow, frames in apart if fast > 0.0]
        ratio, fast, slow, frames = max(known, default=(0.0, 0.0, 0.0, 0.0))
        if ratio > SPREAD:
            lines.append(f"{frames:,.0f} frames took {duration(fast)} and {duration(slow)} in {group}")
    return lines


def _same_work(one: Run, other: Run) -> tuple[float, float, float]:
    """Return the shorter and longer time (s) of two runs for the frames both collected, and these; zeros if unknown.

    Times are interpolated between evaluations.
    """
    timed = [[row for row in run.rows if "wall_s" in row] for run in (one, other)]
    if not all(timed):
        return 0.0, 0.0, 0.0
    frames = min(rows[-1]["frames"] for rows in timed)
    times = []
    for rows in timed:
        collected, took = ([0.0, *(row[key] for row in rows)] for key in ("frames", "wall_s"))
        times.append(float(np.interp(frames, collected, took)))
    return min(times), max(times), frames


def time_limit(groups: Mapping[str, Sequence[Run]]) -> Limit | None:
    """Return the shortest of the groups' median training times; ``None`` if fewer than two groups have one.

    Runs that crashed or were stopped did not take as long as a training does, so they do not count for it.
    """
    medians = {}
    for group, runs in groups.items():
        times = whole_times(runs)
        medians[group] = float(np.median(times)) if times else math.nan
    known = [group for group, seconds in medians.items() if math.isfinite(seconds)]
    if len(known) < 2:
        return None
    fastest = min(known, key=lambda group: medians[group])
    return Limit(medians[fastest], fastest, medians)


def reached(run: Run, seconds: float) -> Reached | None:
    """Return the results of a run after ``seconds``; ``None`` if it had evaluated no policy yet.

    Trainings are deterministic, so with that time limit a run would have kept the policy which ``stop_when`` ranks
    first of those evaluated until then, the earliest of equals. A run that ended sooner stays as it was. Frames and
    updates are interpolated between evaluations.
    """
    timed = [row for row in run.rows if "wall_s" in row]
    until = [row for row in timed if row["wall_s"] <= seconds and "return_mean" in row]
    if not until:
        return None
    best, times = max(until, key=run.rule.score), [row["wall_s"] for row in timed]
    frames, updates = (
        float(np.interp(seconds, times, [row.get(key, math.nan) for row in timed])) for key in ("frames", "updates")
    )
    return Reached(best["return_mean"], best.get("success_rate", math.nan), frames, updates)


def reached_by(groups: Mapping[str, Sequence[Run]], seconds: float) -> dict[str, list[Reached]]:
    """Return the results of each group's runs after ``seconds``; runs without an evaluated policy are left out."""
    results = {group: [reached(run, seconds) for run in runs] for group, runs in groups.items()}
    return {group: [one for one in ones if one is not None] for group, ones in results.items()}
