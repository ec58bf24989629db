"""One evaluated episode of a policy, and the gait in it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gctd3.evaluation import gait_metrics
from gctd3.evaluation.recorder import Motion

LAST_METRES = 10.0  # over which gaits are evaluated, so that the start does not count


@dataclass(frozen=True)
class Episode:
    """Hold the record of one episode; ``T`` is its number of steps.

    Attributes:
        reward: Reward of each step, shape ``[T]``.
        position: Distance walked, shape ``[T]`` (m).
        height: Body height relative to standing, shape ``[T]`` (m).
        hips: Hip angles in the sense of the first leg's, one column per foot, shape ``[T, feet]`` (rad).
        feet_down: Contacts, shape ``[T, feet]``.
        success: Whether the robot reached the finish.
        pairs: Feet on the right and left that mirror each other.
        motion: The motion at the resolution of the physics, if it was recorded.
        command: Commanded velocity when each step's action was chosen, forward, to the left and turning, shape
            ``[T, 3]`` (m/s, m/s, rad/s); ``None`` for a task without commands.
        moved: Velocities of the same kind after each step, shape ``[T, 3]``; ``None`` for a task without commands.
        fell: Whether the episode terminated.
        jump: Commanded height of a jump, and its apex (m); ``None`` for a task without jumps.
        ground: Kind and level of the terrain on which it began; ``None`` on a plane.
    """

    reward: np.ndarray
    position: np.ndarray
    height: np.ndarray
    hips: np.ndarray
    feet_down: np.ndarray
    success: bool
    pairs: tuple[tuple[int, int], ...] = ((0, 1),)
    motion: Motion | None = None
    command: np.ndarray | None = None
    moved: np.ndarray | None = None
    fell: bool = False
    jump: tuple[float, float] | None = None
    ground: tuple[str, int] | None = None

    def velocity(self, dt: float) -> float:
        """Compute the mean velocity, distance over time (m/s)."""
        return float(self.position[-1]) / (len(self.position) * dt)

    @property
    def walked(self) -> np.ndarray | None:
        """Mark the steps of the last 10 m, shape ``[T]``; ``None`` if the robot did not get that far."""
        walked = self.position > self.position[-1] - LAST_METRES
        return None if self.position[-1] < LAST_METRES or walked.sum() < 2 else walked

    def gait(self, dt: float) -> dict[str, float] | None:
        """Compute gait metrics over the last 10 m; ``None`` if the robot did not get that far."""
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
