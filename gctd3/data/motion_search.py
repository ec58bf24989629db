"""The search for open-loop motions in the warm-up: all robots try motions, and the fittest one is shown."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import torch
from torch import Tensor

from gctd3.data.trials import NOTHING, Shown, Trials


class MotionSearch(torch.nn.Module, ABC):
    """Search for a fit open-loop motion while all robots try motions.

    In the last round of a warm-up robots try the fittest few motions again, and at its end the winner, from which a
    policy learns it.

    Args:
        num_robots: Number of robots.
        trials: How motions are tried.
        unit: Frequency of which a motion's frequency is a multiple, or that of its clock (Hz).
    """

    last: Tensor
    age: Tensor
    taken: Tensor
    final: Tensor

    FINALISTS = 8  # fittest motions that are tried in the last round; the best one by the mean wins
    LAST_ROUND: float  # share of the warm-up, at its end, in which robots try the fittest few motions
    SHOWN: float  # share of the warm-up, at its end, in which all robots try the winner, for a policy to learn it from

    def __init__(self, num_robots: int, trials: Trials, unit: float) -> None:
        super().__init__()
        self._dt, self._unit, steps = trials.control_dt, unit, trials.steps
        self._limit = math.inf if trials.limit is None else trials.limit
        self._last_round = math.inf if steps is None else (1.0 - self.LAST_ROUND) * steps
        self._shown = math.inf if steps is None or not self.SHOWN else round((1.0 - self.SHOWN) * steps)
        # Return of the episode up to the last step, and control steps since the trial began: -1 before the first one.
        self.register_buffer("last", torch.zeros(num_robots))
        self.register_buffer("age", torch.full((num_robots,), -1, dtype=torch.int64))
        # Control steps of the warm-up so far, and whether its end has begun.
        self.register_buffer("taken", torch.zeros((), dtype=torch.int64))
        self.register_buffer("final", torch.zeros((), dtype=torch.bool))

    @abstractmethod
    def forward(
        self,
        is_init: Tensor,
        returned: Tensor,
        position: Tensor | None = None,
        shown: Shown = NOTHING,
    ) -> Tensor:
        """Return the actions ``[robots, A]`` of the next step.

        Args:
            is_init: Robots whose episode begins, bool ``[robots]``.
            returned: Sum of the episode's rewards so far, ``[robots]``.
            position: Distance walked in the episode, ``[robots]`` (m); needed only with a least speed.
            shown: What observations of the robots show.
        """

    @property
    @abstractmethod
    def tried(self) -> bool:
        """Return whether there is a fittest motion: enough of them were tried to their ends."""

    @property
    @abstractmethod
    def shows(self) -> bool:
        """Return whether robots that try the winner are known, and go on to do so until the warm-up ends."""

    @property
    @abstractmethod
    def followers(self) -> Tensor:
        """Return which robots try the winner while :attr:`shows` holds, bool ``[robots]``."""

    @property
    def decides(self) -> bool:
        """Return whether in the next step all robots give up their trials and begin to try the winner."""
        return False

    @property
    def anew(self) -> bool:
        """Return whether robots had best begin anew before the next step."""
        return False

    def inherit(self, other: MotionSearch) -> None:
        """Begin with what another search of the same kind has come to; a kind that cannot begins from nothing."""

    @abstractmethod
    def fittest_action(self, phase: Tensor, shown: Shown = NOTHING) -> Tensor:
        """Return the actions of the fittest motion after states of the given phases.

        Args:
            phase: Phase of the motion's clock, ``[*]`` (periods).
            shown: What observations of these states show, ``[*, ...]``.

        Returns:
            Actions, ``[*, A]``.
        """
