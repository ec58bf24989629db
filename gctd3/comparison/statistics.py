"""Statistics over seeds by rliable (Agarwal et al. 2021): interquartile means, bootstrap intervals, profiles."""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from rliable import library

REPETITIONS = 2000  # of the bootstrap
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
    with _seeded():
        point, ends = library.get_interval_estimates(
            # Indices of runs, not their numbers: rliable would draw runs anew for each number.
            {"all": np.arange(len(scores))[:, None]},
            lambda drawn: estimate(scores[drawn[:, 0]]),
            reps=REPETITIONS,
        )
    return np.asarray(point["all"]), np.asarray(ends["all"])


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
    with _seeded():
        point, ends = library.get_interval_estimates({"pair": [x, y]}, higher, reps=REPETITIONS)
    return Interval(float(point["pair"][0]), float(ends["pair"][0, 0]), float(ends["pair"][1, 0]))


def higher(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the share of pairs of ``x [R, 1]``, ``y [S, 1]`` with higher ``x``, ties counting half, shape ``[1]``."""
    return np.array([np.mean((x > y.T) + 0.5 * (x == y.T))])


def profile(scores: Sequence[float], thresholds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the fraction of runs that score above each threshold, with intervals: shapes ``[K]`` and ``[2, K]``."""
    above = (np.array(scores)[:, None] > thresholds).astype(float)
    return intervals(above, lambda drawn: np.asarray(drawn.mean(axis=0)))


@contextmanager
def _seeded() -> Iterator[None]:
    """Seed NumPy's global generator for rliable, restore it afterwards, and silence the log of absl."""
    state = np.random.get_state()
    logging.getLogger("absl").setLevel(logging.WARNING)
    np.random.seed(0)
    try:
        yield
    finally:
        np.random.set_state(state)
