"""Least squares within bounds, for a few unknowns (Levenberg and Marquardt)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

_ROUNDS = 40  # at most
_STEP = 1e-5  # of numerical derivatives, in units of the unknowns


def fit_within(
    residual: Callable[[np.ndarray], np.ndarray], start: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, float]:
    """Minimise a sum of squares within bounds; return where, shape ``[D]``, and how small.

    Args:
        residual: Values ``[K]`` whose squares are summed, of unknowns ``[D]``.
        start: Unknowns to begin with, within the bounds, shape ``[D]``.
        low: Lower bounds, shape ``[D]``.
        high: Upper bounds, shape ``[D]``.
    """
    angles, values, damping = start.copy(), residual(start), 1e-3
    for _ in range(_ROUNDS):
        columns = [(residual(angles + step) - values) / _STEP for step in _STEP * np.eye(len(angles))]
        jacobian = np.stack(columns, axis=1)
        gradient = jacobian.T @ values
        # At a bound only steps inwards count.
        free = ~(((angles <= low) & (gradient > 0)) | ((angles >= high) & (gradient < 0)))
        if not free.any():
            break
        normal = jacobian[:, free].T @ jacobian[:, free]
        step = np.zeros(len(angles))
        step[free] = -np.linalg.solve(normal + damping * np.eye(int(free.sum())), gradient[free])
        tried = np.clip(angles + np.clip(step, -0.5, 0.5), low, high)
        new = residual(tried)
        if new @ new < values @ values:
            done = values @ values - new @ new < 1e-12
            angles, values, damping = tried, new, max(damping / 3, 1e-9)
            if done:
                break
        else:
            damping *= 4
            if damping > 1e6:
                break
    return angles, float(values @ values)
