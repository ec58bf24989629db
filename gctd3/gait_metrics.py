"""Numbers that say what kind of gait a robot has. NumPy in, floats out; units and formulas stand in each docstring."""

from __future__ import annotations

import itertools

import numpy as np


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Pearson correlation of two signals ``[T]``; of left and right hip angle it is near -1 when legs alternate.

    NaN if either is constant.
    """
    if np.ptp(a) == 0 or np.ptp(b) == 0:
        return float("nan")
    a, b = a - a.mean(), b - b.mean()
    return float((a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum()))


def support_fractions(feet_down: np.ndarray) -> tuple[float, float, float]:
    """Fractions of time with no foot, one foot and more feet on the ground, from contacts ``[T, feet]``."""
    down = np.asarray(feet_down, dtype=bool).sum(axis=1)
    return float((down == 0).mean()), float((down == 1).mean()), float((down > 1).mean())


def debounce(contact: np.ndarray, steps: int = 2) -> np.ndarray:
    """The contact signal ``[T]`` without interruptions and touches of at most ``steps`` samples."""
    clean = np.array(contact, dtype=bool)
    # Gaps first: a bouncing touchdown is one stance, not several.
    for state in (False, True):
        changes = np.flatnonzero(np.diff(clean)) + 1
        for begin, end in itertools.pairwise(changes):
            if clean[begin] == state and end - begin <= steps:
                clean[begin:end] = not state
    return clean


def touchdowns(contact: np.ndarray) -> np.ndarray:
    """Indices at which a foot's debounced contact ``[T]`` begins."""
    clean = debounce(contact)
    return np.flatnonzero(clean[1:] & ~clean[:-1]) + 1


def stride_frequency(feet_down: np.ndarray, dt: float) -> float:
    """Strides per second (Hz): a stride lasts from a foot's touchdown to its next; median over strides of all feet.

    NaN if no foot completes two strides, so that a gait without strides gets no number.

    Args:
        feet_down: Contacts, shape ``[T, feet]``.
        dt: Sampling period (s).
    """
    strides = [np.diff(touchdowns(contact)) for contact in np.asarray(feet_down, dtype=bool).T]
    periods = np.concatenate(strides) if strides else np.array([])
    return float(1.0 / (np.median(periods) * dt)) if len(periods) >= 2 else float("nan")
