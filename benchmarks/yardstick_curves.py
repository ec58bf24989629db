"""Compare learning curves of two sides: intervals over seeds, differences, a table, a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

SIDES = ("gctd3", "sb3")
NAMES = {"gctd3": "gctd3", "sb3": "Stable-Baselines3"}
MILLION = 1_000_000  # steps, after which the published returns were measured
# Means and standard deviations over seeds at a million steps, of versions 2 to 4 of the tasks, in the order of the TD3
# paper or the SAC paper's curves as later papers quote them, CleanRL, Tianshou, RL-Zoo; a single run has no deviation.
PUBLISHED: dict[tuple[str, str], list[tuple[float, float | None]]] = {
    ("walker2d", "td3"): [(4683, 540), (4058, 659), (3982, 275), (4718, None)],
    ("walker2d", "sac"): [(5007, 252), (3591, 911), (3863, None)],
    ("walker2d", "ddpg"): [(1401, 905), (1240, 390), (1844, None)],
    ("halfcheetah", "td3"): [(9637, 859), (9583, 126), (10201, 773), (9656, None)],
    ("halfcheetah", "sac"): [(12139, 1049), (9635, 1424), (9535, None)],
    ("halfcheetah", "ddpg"): [(11719, 466), (10374, 157), (3306, None)],
}


@dataclass
class Run:
    """One training.

    Attributes:
        task: Name of the task in ``conf/env``.
        algo: Algorithm.
        side: Whose.
        seed: Seed of the training.
        commit: Commit of this project when it was started.
        minutes: Wall-clock until its last evaluation.
        curve: Its evaluations: ``frames``, ``return_mean``, ``return_std`` and more.
    """

    task: str
    algo: str
    side: str
    seed: int
    commit: str = ""
    minutes: float = 0.0
    curve: list[dict[str, float]] = field(default_factory=list)

    @property
    def name(self) -> tuple[str, str, str, int]:
        """Return the key that distinguishes it from the others."""
        return self.task, self.algo, self.side, self.seed


@dataclass(frozen=True)
class Mean:
    """A mean over seeds and its 95 % interval, Student's: at three seeds a bootstrap never leaves their range.

    Attributes:
        value: The mean.
        low: Lower end; ``None`` of a single seed.
        high: Upper end.
    """

    value: float
    low: float | None = None
    high: float | None = None

    def overlaps(self, other: Mean) -> bool | None:
        """Whether some number is in both intervals; ``None`` if one is not known."""
        if self.low is None or self.high is None or other.low is None or other.high is None:
            return None
        return self.low <= other.high and other.low <= self.high

    def text(self) -> str:
        """Format the mean as ``5123 [4801, 5445]``."""
        return f"{self.value:.0f}" + (f" [{self.low:.0f}, {self.high:.0f}]" if self.low is not None else "")


def mean(values: Sequence[float]) -> Mean:
    """Compute the mean of one number of each seed, with its interval."""
    array, n = np.array(values, dtype=np.float64), len(values)
    if n < 2:
        return Mean(float(array.mean()))
    half = float(stats.t.ppf(0.975, n - 1) * array.std(ddof=1) / np.sqrt(n))
    return Mean(float(array.mean()), float(array.mean()) - half, float(array.mean()) + half)


def difference(first: Sequence[float], second: Sequence[float]) -> Mean:
    """Compute the difference of two means, with Welch's 95 % interval (Welch 1947)."""
    value = float(np.mean(first) - np.mean(second))
    if min(len(first), len(second)) < 2:
        return Mean(value)
    # Equal numbers on both sides leave nothing to divide by, and the interval is that one number.
    if np.ptp(first) == np.ptp(second) == 0:
        return Mean(value, value, value)
    low, high = stats.ttest_ind(first, second, equal_var=False).confidence_interval(0.95)
    return Mean(value, float(low), float(high))


@dataclass(frozen=True)
class Comparison:
    """Both sides on one task with one algorithm.

    Attributes:
        task: The task.
        algo: The algorithm.
        seeds: Seeds of each side.
        frames: Steps at which every run was evaluated.
        curves: Curve of each side, a mean for each of ``frames``.
        average: Difference, ours minus theirs, of the return averaged over ``frames``.
        overlap: Whether the curves' intervals overlap at each of ``frames``; ``None`` if a side has but one seed.
    """

    task: str
    algo: str
    seeds: dict[str, list[int]]
    frames: list[int]
    curves: dict[str, list[Mean]]
    average: Mean
    overlap: list[bool] | None


def compare(runs: Sequence[Run], task: str, algo: str) -> Comparison | None:
    """``None`` unless there are runs of both sides that were evaluated at a common moment."""
    mine = {side: [r for r in runs if (r.task, r.algo, r.side) == (task, algo, side)] for side in SIDES}
    moments = [{int(row["frames"]) for row in run.curve} for side in SIDES for run in mine[side]]
    frames = sorted(set.intersection(*moments)) if moments else []
    if not frames or not all(mine.values()):
        return None
    returns = {side: np.array([_returns(run, frames) for run in mine[side]]) for side in SIDES}
    curves = {side: [mean(column) for column in returns[side].T] for side in SIDES}
    overlaps = [one.overlaps(other) for one, other in zip(*curves.values(), strict=True)]
    return Comparison(
        task,
        algo,
        {side: [run.seed for run in mine[side]] for side in SIDES},
        frames,
        curves,
        difference(*(returns[side].mean(axis=1) for side in SIDES)),
        None if None in overlaps else [bool(value) for value in overlaps],
    )


def _returns(run: Run, frames: Sequence[int]) -> list[float]:
    of = {int(row["frames"]): row["return_mean"] for row in run.curve}
    return [of[moment] for moment in frames]


def table(comparisons: Sequence[Comparison]) -> str:
    """A line for each comparison: returns at the last common moment, and the difference over the whole curve."""
    head = ["task", "algo", "seeds", "steps", *(NAMES[side] for side in SIDES), "average difference", "overlap"]
    rows = [head]
    for found in comparisons:
        overlap = "-" if found.overlap is None else f"{sum(found.overlap)}/{len(found.overlap)}"
        last = [found.curves[side][-1].text() for side in SIDES]
        seeds = "/".join(str(len(found.seeds[side])) for side in SIDES)
        steps = f"{found.frames[-1]:,}"
        rows.append([found.task, found.algo, seeds, steps, *last, found.average.text(), overlap])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    for found in comparisons:
        if found.frames[-1] >= MILLION:
            values = ", ".join(f"{m:.0f}" + (f" ± {sd:.0f}" if sd else "") for m, sd in published(found))
            lines.append(f"published for {found.algo} on {found.task} at {MILLION:,} steps: {values}")
    return "\n".join(lines)


def published(found: Comparison) -> list[tuple[float, float | None]]:
    """Returns at a million steps elsewhere."""
    return PUBLISHED[found.task, found.algo]


def figures(comparisons: Sequence[Comparison]) -> list[dict[str, Any]]:
    """The same for JSON, with the published returns."""
    return [{**asdict(found), "published_at_1M": published(found)} for found in comparisons]


def draw(comparisons: Sequence[Comparison], file: Path) -> None:
    """Learning curves with their intervals, a panel for each comparison; published means where curves are as long."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    tasks = list(dict.fromkeys(found.task for found in comparisons))
    algos = list(dict.fromkeys(found.algo for found in comparisons))
    size = (4.0 * len(algos), 3.0 * len(tasks))
    figure, axes = plt.subplots(len(tasks), len(algos), figsize=size, squeeze=False, layout="constrained")
    for axis in axes.flat:
        axis.set_visible(False)
    for found in comparisons:
        axis = axes[tasks.index(found.task), algos.index(found.algo)]
        axis.set_visible(True)
        for colour, side in zip(("C0", "C1"), SIDES, strict=True):
            curve = found.curves[side]
            label = f"{NAMES[side]} ({len(found.seeds[side])})"
            axis.plot(found.frames, [point.value for point in curve], color=colour, label=label)
            if curve[0].low is not None:
                ends = [point.low for point in curve], [point.high for point in curve]
                axis.fill_between(found.frames, *ends, color=colour, alpha=0.2, linewidth=0)
        if found.frames[-1] >= MILLION:
            for value, _ in published(found):
                axis.axhline(value, color="0.5", linewidth=0.8, linestyle=":")
        axis.set(title=f"{found.algo}, {found.task}", xlabel="steps", ylabel="return")
        axis.legend(fontsize=8, frameon=False)
    figure.savefig(file, dpi=120)
    plt.close(figure)
