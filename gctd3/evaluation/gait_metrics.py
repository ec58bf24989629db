"""Gait metrics, computed from contacts and joint angles.

NumPy in, floats out; units, formulas and sources stand in each docstring. Undefined numbers are NaN. Contacts
are debounced here, and a stride lasts from a foot's touchdown to its next. :mod:`.effort` has a gait's costs.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

SHORTEST = 2  # samples; a contact or an interruption of at most that length is sensor noise
DROPPED = 2  # strides of each foot at the start that are not counted: the gait has yet to settle
FEWEST = 3  # strides of a foot; with fewer its period is not evaluated
LARGEST_VARIATION = 0.25  # of a periodic gait's stride times; people walk at 0.02 to 0.03 (Hausdorff 2005)
LEAST_REGULARITY = 0.7  # of a periodic gait
SHORTEST_SWING = 0.2  # of the stride; a foot that is up for less has bounced (people swing for 0.4)
PHASES = 100  # samples of a stride, for comparing strides of different length


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Compute the Pearson correlation of two signals ``[T]``; that of the hip angles is near -1 when legs alternate.

    NaN if either is constant.
    """
    if np.ptp(a) == 0 or np.ptp(b) == 0:
        return float("nan")
    a, b = a - a.mean(), b - b.mean()
    return float((a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum()))


def support_fractions(feet_down: np.ndarray) -> tuple[float, float, float]:
    """Compute the fractions of time with no, one and more feet on the ground, from contacts ``[T, feet]``."""
    down = np.asarray(feet_down, dtype=bool).sum(axis=1)
    return float((down == 0).mean()), float((down == 1).mean()), float((down > 1).mean())


def debounce(contact: np.ndarray, gap: int = SHORTEST, touch: int = SHORTEST) -> np.ndarray:
    """Remove interruptions of at most ``gap`` samples and touches of at most ``touch`` from a contact ``[T]``."""
    clean = np.array(contact, dtype=bool)
    # Gaps first: a bouncing touchdown is one stance, not several.
    for state, longest in ((False, gap), (True, touch)):
        changes = np.flatnonzero(np.diff(clean)) + 1
        for begin, end in itertools.pairwise(changes):
            if clean[begin] == state and end - begin <= longest:
                clean[begin:end] = not state
    return clean


def touchdowns(contact: np.ndarray) -> np.ndarray:
    """Find the indices at which a foot's debounced contact ``[T]`` begins."""
    clean = debounce(contact)
    return np.flatnonzero(clean[1:] & ~clean[:-1]) + 1


def stride_frequency(feet_down: np.ndarray, dt: float) -> float:
    """Compute the strides per second (Hz), from a foot's touchdown to its next; the median over strides of all feet.

    NaN for fewer than two strides of all feet together, so that a gait without strides gets no number.

    Args:
        feet_down: Contacts, shape ``[T, feet]``.
        dt: Sampling period (s).
    """
    strides = [np.diff(touchdowns(contact)) for contact in np.asarray(feet_down, dtype=bool).T]
    periods = np.concatenate(strides) if strides else np.array([])
    return float(1.0 / (np.median(periods) * dt)) if len(periods) >= 2 else float("nan")


# Strides.


def strides(contact: np.ndarray, drop: int = DROPPED) -> np.ndarray:
    """Find the strides in one foot's contact signal ``[T]``, without the first ``drop``.

    Returns:
        First index of each stride and of the one after it, shape ``[K, 2]``.
    """
    down = touchdowns(contact)
    return np.stack([down[:-1], down[1:]], axis=1)[drop:] if len(down) > 1 else np.zeros((0, 2), dtype=np.int64)


def stride_variation(strides: np.ndarray) -> float:
    """Compute the coefficient of variation of stride times: standard deviation over mean (Hausdorff 2005).

    NaN for fewer than two strides ``[K, 2]``.
    """
    periods = np.diff(strides, axis=1)
    return float(periods.std() / periods.mean()) if len(periods) > 1 else float("nan")


def is_periodic(feet: Sequence[np.ndarray]) -> bool:
    """Tell whether every foot takes at least three strides, and their times vary by at most a quarter.

    Symmetry, phase and stability are not defined for a gait that is not periodic.

    Args:
        feet: Strides of each foot, as :func:`strides` finds them.
    """
    enough = len(feet) > 0 and all(len(foot) >= FEWEST for foot in feet)
    return enough and all(stride_variation(foot) <= LARGEST_VARIATION for foot in feet)


def duty_factor(contact: np.ndarray, strides: np.ndarray) -> float:
    """Compute the duty factor, contact over stride time (Alexander 1984), the mean over strides.

    A biped walks above 0.5 and runs below.

    Args:
        contact: Contact of the foot, shape ``[T]``.
        strides: Strides of the same foot, shape ``[K, 2]``.
    """
    clean = debounce(contact)
    return _mean([clean[begin:end].mean() for begin, end in strides])


def phase_offset(strides: np.ndarray, touchdowns: np.ndarray) -> float:
    """Compute the phase of one foot's stride at which the other touches down, in [0, 1); 0.5 for alternating legs.

    It is the circular mean over strides of ``(t_other - t_begin) / (t_end - t_begin)``; a stride in which the other
    foot does not touch down is left out. NaN if it never does.

    Args:
        strides: Strides of the one foot, shape ``[K, 2]``.
        touchdowns: Touchdowns of the other foot, shape ``[M]``.
    """
    return circular_mean(
        [(t - begin) / (end - begin) for begin, end in strides for t in touchdowns if begin <= t < end]
    )


def circular_mean(phases: Sequence[float]) -> float:
    """Compute the mean of fractions of a stride, in [0, 1): that of 0.9 and 0.1 is 0. NaN values are left out."""
    known = np.array([phase for phase in phases if np.isfinite(phase)])
    if not len(known):
        return float("nan")
    mean = np.angle(np.exp(2j * np.pi * known).mean()) / (2 * np.pi)
    # Rounded, since an offset of 0 may come out as a tiny negative number, which modulo 1 is 1 and not 0.
    return float(np.round(mean, 12) % 1.0)


def swing_clearance(height: np.ndarray, contact: np.ndarray) -> float:
    """Measure the height of a foot in mid-swing (m), the median over swings (Winter 1992 calls it toe clearance).

    The middle is halfway in time between lift-off and touchdown; swings at either end of the signal are left out.

    Args:
        height: Height of the sole's lowest point above the ground, shape ``[T]`` (m).
        contact: Contact of the foot, shape ``[T]``.
    """
    clean, down = debounce(contact), touchdowns(contact)
    lifts = np.flatnonzero(~clean[1:] & clean[:-1]) + 1
    middles = [(lift + down[down > lift][0] - 1) // 2 for lift in lifts if (down > lift).any()]
    return float(np.median(height[middles])) if middles else float("nan")


# Symmetry.


def symmetry_index(right: float, left: float) -> float:
    """Compute the symmetry index ``(X_R - X_L) / (0.5 (X_R + X_L)) * 100`` (%), Herzog et al. 1989; 0 if equal.

    It is for positive quantities and says nothing about an angle, whose mean may be zero; see :func:`shifted_rms`.
    """
    total = 0.5 * (right + left)
    return float((right - left) / total * 100.0) if total else float("nan")


def mean_stride(signal: np.ndarray, strides: np.ndarray, phases: int = PHASES) -> np.ndarray:
    """Average a signal ``[T]`` over strides ``[K, 2]``, each interpolated at ``phases`` samples."""
    grid = np.arange(phases) / phases
    times = np.arange(len(signal))
    return np.mean([np.interp(begin + grid * (end - begin), times, signal) for begin, end in strides], axis=0)


def shifted_rms(right: np.ndarray, left: np.ndarray, strides: np.ndarray) -> float:
    """Compute the RMS difference between a right joint and the left joint half a stride later (rad).

    ``sqrt(mean_p (R(p) - L(p + 1/2))^2)`` over the phases ``p`` of the mean stride; 0 for legs that alternate in the
    same movement.

    Args:
        right: Angle of a right joint, shape ``[T]`` (rad).
        left: Angle of the same joint on the left, in the same sense, shape ``[T]`` (rad).
        strides: Strides of the right foot, shape ``[K, 2]``.
    """
    if not len(strides):
        return float("nan")
    shifted = np.roll(mean_stride(left, strides), -PHASES // 2)
    return rms(mean_stride(right, strides) - shifted)


def rms(values: np.ndarray) -> float:
    """Compute the root mean square of all values."""
    return float(np.sqrt(np.mean(np.square(values))))


# Periodicity and stability.


def regularity(signals: np.ndarray, lag: int) -> float:
    """Compute the autocorrelation of signals at ``lag`` samples, in [-1, 1]; 1 for a periodic motion.

    ``sum_t x_t x_{t+lag} / sqrt(sum_t x_t^2 sum_t x_{t+lag}^2)`` about the mean, over all signals together, after the
    stride regularity of Moe-Nilssen & Helbostad 2004. NaN for fewer than two strides, or if nothing moves.

    Args:
        signals: Signals, shape ``[T, J]``.
        lag: Samples in a stride.
    """
    if lag < 1 or len(signals) < 2 * lag:
        return float("nan")
    about = signals - signals.mean(axis=0)
    a, b = about[:-lag], about[lag:]
    size = np.sqrt((a * a).sum() * (b * b).sum())
    return float((a * b).sum() / size) if size else float("nan")


def stride_lag(signals: np.ndarray) -> int | None:
    """Find the samples in a stride of joint angles ``[T, J]``: the first lag at which they repeat nearly best.

    It is the first peak of :func:`regularity` past its first zero that comes within 0.1 of the highest; alternating
    legs do not repeat after half a stride. ``None`` if no peak reaches 0.7: then the motion is not periodic.
    """
    values = np.array([regularity(signals, lag) for lag in range(1, len(signals) // 2 + 1)])
    below = np.flatnonzero(values < 0)
    if not len(below):
        return None
    inside = np.flatnonzero((values[1:-1] >= values[:-2]) & (values[1:-1] >= values[2:])) + 1
    peaks = inside[inside > below[0]]
    if not len(peaks) or values[peaks].max() < LEAST_REGULARITY:
        return None
    return int(peaks[values[peaks] >= values[peaks].max() - 0.1][0]) + 1


def floquet_multipliers(sections: Sequence[np.ndarray]) -> np.ndarray | None:
    """Estimate the eigenvalues of the touchdown map ``A``, largest first: deviations from the mean obey ``d' = A d``.

    ``A`` is the least-squares fit over all pairs of the state at a touchdown and at the next. If all eigenvalues lie
    within the unit circle, deviations from the cycle die out (Hurmuzlu & Basdogan 1994). Noise pulls the
    estimate towards zero (Ahn & Hogan 2015), and so does a touchdown that is known to a sample only: these are
    estimates from below.

    Args:
        sections: For each episode the states at one foot's touchdowns, shape ``[K, n]``.

    Returns:
        Complex eigenvalues, shape ``[n]``; ``None`` with fewer than ``3 n`` pairs, too few to fit to.
    """
    usable = [section for section in sections if len(section) > 1]
    pairs = sum(len(section) - 1 for section in usable)
    if not usable or pairs < 3 * usable[0].shape[1]:
        return None
    before = np.concatenate([section[:-1] for section in usable])
    after = np.concatenate([section[1:] for section in usable])
    # In units of its own spread, so that metres and radians weigh alike; eigenvalues do not change.
    spread = before.std(axis=0)
    moving = spread > 1e-9
    if not moving.any():
        return np.zeros(len(spread), dtype=complex)
    centre, scale = before[:, moving].mean(axis=0), spread[moving]
    x, y = (before[:, moving] - centre) / scale, (after[:, moving] - centre) / scale
    y = y - y.mean(axis=0)
    matrix = np.linalg.lstsq(x, y, rcond=1e-6)[0]
    values = np.zeros(len(spread), dtype=complex)
    values[: moving.sum()] = np.linalg.eigvals(matrix)
    return values[np.argsort(-np.abs(values), kind="stable")]


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if len(values) else float("nan")
