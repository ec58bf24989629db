"""Errors of features that have a noise of their own, such as a height scan's."""

from __future__ import annotations

import numpy as np

Generator = np.random.Generator | np.random.RandomState
OWN_NOISE = "sensors.noise"  # name in the memory: the errors of the present frame, shape [*, N, F]


class SensorNoise:
    """Draw the errors of one frame.

    Args:
        deviations: Standard deviation of each number's error, shape ``[N, F]``.
    """

    def __init__(self, deviations: np.ndarray) -> None:
        self.shape = deviations.shape
        self._at = np.flatnonzero(deviations)
        self._deviations = deviations.reshape(-1)[self._at]

    @property
    def any(self) -> bool:
        """Return whether a number has an error."""
        return len(self._at) > 0

    def draw(self, shape: tuple[int, ...], rng: Generator) -> np.ndarray:
        """Draw normally distributed errors for robots of a shape, ``float32 [*, N, F]``."""
        noise = np.zeros((*shape, self.shape[0] * self.shape[1]), dtype=np.float32)
        noise[..., self._at] = self._deviations * rng.normal(size=(*shape, len(self._at)))
        return noise.reshape(*shape, *self.shape)
