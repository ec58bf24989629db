"""Statistics over seeds after Agarwal et al. 2021: interquartile means, bootstrap intervals, performance profiles.

The numbers are those of their library, rliable 1.2, from the same draws of runs.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

REPETITIONS = 2000  # of the bootstrap
ENDS = (2.5, 97.5)  # percentiles at the ends of an interval
FEW = 5  # seeds below which an interval says little


@dataclass(frozen=True)
class Interval:
    """Represent an estimate and the 95 % interval around it.

    Attributes:
        value: The estimate.
        low: Lower end; NaN if there was only one run.
        high: Upper end, likewise.
    """

    value: float
    low: float
    high: float

    def overlaps(self, other: Interval) -> bool:
        """Return whether two intervals overlap; true as well if one is unknown, as that of a single run."""
        return not (self.low > other.high or other.low > self.high)

    def text(self, digits: int = 1) -> str:
        """Format the interval as ``497.2 [470.1, 540.2]``."""
        if not np.isfinite(self.value):
            return "undefined"
        if not np.isfinite(self.low):
            return f"{self.value:.{digits}f}"
        return f"{self.value:.{digits}f} [{self.low:.{digits}f}, {self.high:.{digits}f}]"


def iqm(scores: np.ndarray) -> np.ndarray:
    """Compute the interquartile mean over the first axis: lowest and highest quarter, rounded down, left out."""
    cut = len(scores) // 4
    return np.asarray(np.sort(scores, axis=0)[cut : len(scores) - cut].mean(axis=0))


def bootstrap(statistic: Callable[..., np.ndarray], *groups: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute a statistic of groups of runs, and its 95 % percentile interval by the stratified bootstrap.

    Each repetition draws as many runs of each group as it has, with replacement. A run's numbers stay together. Equal
    arguments give equal intervals.

    Args:
        statistic: Function of the groups that returns shape ``[K]``.
        groups: The numbers of each group's runs, shapes ``[R, ...]``.

    Returns:
        The statistic and the ends of its interval, shapes ``[K]`` and ``[2, K]``.
    """
    random = np.random.RandomState(0)
    repeated = [statistic(*(runs[random.choice(len(runs), len(runs))] for runs in groups)) for _ in range(REPETITIONS)]
    return np.asarray(statistic(*groups)), np.percentile(repeated, ENDS, axis=0)


def intervals(scores: np.ndarray, estimate: Callable[[np.ndarray], np.ndarray] = iqm) -> tuple[np.ndarray, np.ndarray]:
    """Compute estimates and their 95 % stratified bootstrap intervals by percentiles, runs drawn with replacement.

    Args:
        scores: Shape ``[R, K]``: ``R`` runs, ``K`` numbers of each, which stay together.
        estimate: Function from ``[R, K]`` to ``[K]``.

    Returns:
        Estimates and interval ends, shapes ``[K]`` and ``[2, K]``; the ends are NaN if there is only one run.
    """
    if len(scores) < 2:
        return estimate(scores), np.full((2, scores.shape[1]), np.nan)
    return bootstrap(estimate, scores)


def interval(scores: Sequence[float]) -> Interval:
    """Compute the interquartile mean and interval of one number of each run; runs without it are left out."""
    return _interval(tuple(score for score in scores if np.isfinite(score)))


@functools.lru_cache
def _interval(scores: tuple[float, ...]) -> Interval:
    known = np.array(scores)
    if not len(known):
        return Interval(np.nan, np.nan, np.nan)
    point, ends = intervals(known[:, None])
    return Interval(float(point[0]), float(ends[0, 0]), float(ends[1, 0]))


def improvement(ours: Sequence[float], theirs: Sequence[float]) -> Interval:
    """Estimate the probability that a run of ours outscores one of theirs, ties counting half (Mann & Whitney 1947)."""
    return _improvement(tuple(ours), tuple(theirs))


@functools.lru_cache
def _improvement(ours: tuple[float, ...], theirs: tuple[float, ...]) -> Interval:
    x, y = np.array(ours)[:, None], np.array(theirs)[:, None]
    if min(len(x), len(y)) < 2:
        return Interval(float(higher(x, y)[0]), np.nan, np.nan)
    point, ends = bootstrap(higher, x, y)
    return Interval(float(point[0]), float(ends[0, 0]), float(ends[1, 0]))


def higher(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the share of pairs of ``x [R, 1]``, ``y [S, 1]`` with higher ``x``, ties counting half, shape ``[1]``."""
    return np.array([np.mean((x > y.T) + 0.5 * (x == y.T))])


def profile(scores: Sequence[float], thresholds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the fraction of runs that score above each threshold, with intervals: shapes ``[K]`` and ``[2, K]``."""
    above = (np.array(scores)[:, None] > thresholds).astype(float)
    return intervals(above, lambda drawn: np.asarray(drawn.mean(axis=0)))
