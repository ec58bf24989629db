"""Results of a race for a gait: the runs, when each one walks, and the table; see ``time_to_gait.py``."""

from __future__ import annotations

import csv
import math
import statistics
from dataclasses import dataclass, field
from pathlib import Path

from gctd3.runs.evaluate import PAPER

RETURN = PAPER["return_mean"]
BASE = "gctd3"  # the others' times are divided by its

Row = dict[str, float]


@dataclass
class Run:
    """One training of a contender.

    Attributes:
        contender: Who trained.
        seed: Seed of the training.
        outcome: ``reached``; ``not within`` the cap; ``ended`` by itself before it walked; ``failed``.
        minutes: Until it walked, or until it was over.
        curve: Its evaluations, each with the ``minutes`` at which it was seen.
        recipe: A peer's hyperparameters.
        exit_code: Exit code of a training that ended by itself.
    """

    contender: str
    seed: int
    outcome: str = "not within"
    minutes: float = 0.0
    curve: list[Row] = field(default_factory=list)
    recipe: dict[str, object] = field(default_factory=dict)
    exit_code: int | None = None

    @property
    def reached(self) -> bool:
        """Whether it walked."""
        return self.outcome == "reached"

    @property
    def best(self) -> Row | None:
        """The evaluation in which most episodes reached the finish, by return among equals."""
        return max(self.curve, key=lambda row: (row["success_rate"], row["return_mean"]), default=None)


def passes(row: Row) -> bool:
    """Whether an evaluation shows a walk."""
    return row["success_rate"] >= 1.0 and row["return_mean"] >= RETURN


def read_progress(file: Path) -> list[Row]:
    """The whole rows of a ``progress.csv`` that may still be written, or not exist yet."""
    if not file.exists():
        return []
    lines = file.read_text(encoding="utf-8").splitlines(keepends=True)
    whole = [line for line in lines if line.endswith("\n")]
    # A metric that an evaluation leaves undefined is left out: JSON has no name for it.
    rows = [{key: float(text) for key, text in row.items() if text} for row in csv.DictReader(whole)]
    return [{key: value for key, value in row.items() if math.isfinite(value)} for row in rows]


def words(row: Row) -> str:
    """An evaluation on a line."""
    done = f"{row['frames']:,.0f} steps, return {row['return_mean']:.1f}, "
    if "followed_rate" in row:
        return done + f"{row['followed_rate']:.0%} of the commands followed, falls {row['fall_rate']:.0%}"
    return done + f"success {row['success_rate']:.0%}, {row['distance_mean']:.1f} m"


def outcome(run: Run, cap: float) -> str:
    """Describe how a run ended, in a line."""
    if run.reached:
        return f"walks after {run.minutes:.1f} min"
    how = {
        "not within": f"not within {cap:g} min",
        "ended": f"ended after {run.minutes:.1f} min without walking",
        "failed": f"failed with exit code {run.exit_code} after {run.minutes:.1f} min, see its log.txt",
    }.get(run.outcome, run.outcome)
    return f"{how}; best: {words(run.best)}" if run.best else f"{how}; never evaluated"


@dataclass(frozen=True)
class Summary:
    """Summarise a contender's runs. A run that did not walk counts as the cap, and makes its statistics lower bounds.

    Attributes:
        reached: Runs that walked.
        all: Runs.
        median: Minutes; ``min`` and ``max`` likewise.
        min: Minutes.
        max: Minutes.
        bounds: Which of the three are lower bounds.
        frames: Median steps of the runs that walked, ``None`` if none did.
    """

    reached: int
    all: int
    median: float
    min: float
    max: float
    bounds: list[str]
    frames: float | None

    def minutes(self, name: str) -> str:
        """``median``, ``min`` or ``max`` as a text."""
        return f"{'>' if name in self.bounds else ''}{getattr(self, name):.1f}"


def summary(runs: list[Run], cap: float) -> Summary:
    """Compute the summary of one contender's runs."""
    times = sorted((run.minutes if run.reached else cap, not run.reached) for run in runs)
    # Of an even number the later of the two middle ones decides whether their mean is known.
    deciding = {"median": times[len(times) // 2], "min": times[0], "max": times[-1]}
    frames = [run.curve[-1]["frames"] for run in runs if run.reached]
    return Summary(
        reached=len(frames),
        all=len(runs),
        median=statistics.median(minutes for minutes, _ in times),
        min=times[0][0],
        max=times[-1][0],
        bounds=[name for name, (_, beyond) in deciding.items() if beyond],
        frames=statistics.median(frames) if frames else None,
    )


def ratio(mine: Summary, base: Summary | None) -> str:
    """Median over the base's median; unknown if the base's is itself only a bound."""
    if base is None or "median" in base.bounds:
        return "-"
    return f"{'>' if 'median' in mine.bounds else ''}{mine.median / base.median:.1f}"


def table(runs: list[Run], cap: float) -> str:
    """A line for each contender, then one for each run that did not walk."""
    names = list(dict.fromkeys(run.contender for run in runs))
    found = {name: summary([run for run in runs if run.contender == name], cap) for name in names}
    titles = ("walks", "median min", "min", "max", "steps", f"x {BASE}")
    lines = [f"{'':10}" + "".join(f"{title:>12}" for title in titles)]
    for name, figures in found.items():
        minutes = [figures.minutes(key) for key in ("median", "min", "max")]
        frames = "-" if figures.frames is None else f"{figures.frames:,.0f}"
        cells = [f"{figures.reached}/{figures.all}", *minutes, frames, ratio(figures, found.get(BASE))]
        lines.append(f"{name:10}" + "".join(f"{cell:>12}" for cell in cells))
    lines += [f"{run.contender} seed {run.seed}: {outcome(run, cap)}" for run in runs if not run.reached]
    return "\n".join(lines)
