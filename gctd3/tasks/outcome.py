"""What a control step was worth, and whether it ended the episode."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Outcome:
    """What a step was worth and whether it ended the episode; every array has shape ``[*]``.

    Attributes:
        terms: The reward, term by term; its sum is :attr:`reward`.
        terminated: A termination holds whose value is not bootstrapped.
        truncated: Another one holds (and none of those).
        success: One holds that the task is about (and none of those that terminate).
        diverged: The simulation failed.
    """

    terms: dict[str, Any]
    terminated: np.ndarray
    truncated: np.ndarray
    success: np.ndarray
    diverged: np.ndarray

    @property
    def reward(self) -> np.ndarray:
        """Sum the terms, in their order."""
        total: np.ndarray = functools.reduce(lambda total, term: total + term, self.terms.values())
        return total
