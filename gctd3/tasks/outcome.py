"""The outcome of a control step: its reward, and whether it ended the episode."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Outcome:
    """Hold the reward of a step and whether it ended the episode; every array has shape ``[*]``.

    Attributes:
        terms: Terms of the reward by name; their sum is :attr:`reward`.
        terminated: Whether a termination holds whose value is not bootstrapped.
        truncated: Whether a termination holds whose value is bootstrapped, and the episode is not terminated.
        success: Whether a successful termination holds, and the episode is not terminated.
        diverged: Whether the simulation failed.
    """

    terms: dict[str, Any]
    terminated: np.ndarray
    truncated: np.ndarray
    success: np.ndarray
    diverged: np.ndarray

    @property
    def reward(self) -> np.ndarray:
        """Return the sum of the terms, added in their order."""
        total: np.ndarray = functools.reduce(lambda total, term: total + term, self.terms.values())
        return total
