"""One episode of a policy as it was judged, and the gait in it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gctd3.evaluation import gait_metrics
from gctd3.evaluation.recorder import Motion

LAST_METRES = 10.0  # over which gaits are judged, so that the start does not count


@dataclass(frozen=True)
class Episode:
    """One episode, as it was; ``T`` is its number of steps.

    Attributes:
        reward: Shape ``[T]``.
        position: Distance walked, shape ``[T]`` (m).
        height: Body height from standing, shape ``[T]`` (m).
        hips: Hip angles in the sense of the first leg's, one column per foot, shape ``[T, feet]`` (rad).
        feet_down: Contacts, shape ``[T, feet]``.
        success: Whether it reached the finish.
        pairs: Feet on the right and left that mirror each other.
        motion: The rest of what it did, if that was recorded.
    """

    reward: np.ndarray
    position: np.ndarray
    height: np.ndarray
    hips: np.ndarray
    feet_down: np.ndarray
    success: bool
    pairs: tuple[tuple[int, int], ...] = ((0, 1),)
    motion: Motion | None = None

    def velocity(self, dt: float) -> float:
        """Distance over time (m/s)."""
        return float(self.position[-1]) / (len(self.position) * dt)

    @property
    def walked(self) -> np.ndarray | None:
        """Which steps are of the last 10 m, shape ``[T]``; ``None`` if it did not get that far."""
        walked = self.position > self.position[-1] - LAST_METRES
        return None if self.position[-1] < LAST_METRES or walked.sum() < 2 else walked

    def gait(self, dt: float) -> dict[str, float] | None:
        """Metrics over the last 10 m; ``None`` if it did not get that far."""
        walked = self.walked
        if walked is None:
            return None
        hips = [gait_metrics.correlation(self.hips[walked, i], self.hips[walked, k]) for i, k in self.pairs]
        flight, single, double = gait_metrics.support_fractions(self.feet_down[walked])
        return {
            "hip_correlation": float(np.mean(hips)) if hips else math.nan,
            "stride_hz": gait_metrics.stride_frequency(self.feet_down[walked], dt),
            "flight_fraction": flight,
            "single_support_fraction": single,
            "double_support_fraction": double,
            "height_rms": float(np.sqrt(np.mean((self.height[walked] - self.height[walked].mean()) ** 2))),
        }
