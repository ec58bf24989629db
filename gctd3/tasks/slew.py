"""Commands that change by no more than a robot can follow. Light: exported policies use it too."""

from __future__ import annotations

import numpy as np


def approached(now: np.ndarray, target: np.ndarray, most: np.ndarray) -> np.ndarray:
    """Return numbers that are by at most ``most`` nearer to a target, and the target where it is as near as that.

    Args:
        now: The numbers, shape ``[*, K]``.
        target: What they are to become, shape ``[*, K]``.
        most: Largest change of each, shape ``[K]``; infinite for none.
    """
    away = target - now
    return np.where(np.abs(away) <= most, target, now + np.copysign(most, away))
