"""The search for open-loop motions in the warm-up: all robots try motions, and the fittest one is shown."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import torch
from torch import Tensor

from gctd3.data.trials import NOTHING, Shown, Trials

WAITS = -2  # age of a robot's trial that begins with its next episode


class MotionSearch(torch.nn.Module, ABC):
    """Search for a fit open-loop motion while all robots try motions.

    At the end of a warm-up, or of each of its rounds, robots try the fittest few motions again, and then the winner,
    from which a policy learns it.

    Args:
        num_robots: Number of robots.
        trials: How motions are tried.
        unit: Frequency of which a motion's frequency is a multiple, or that of its clock (Hz).
    """

    last: Tensor
    age: Tensor
    taken: Tensor
    began: Tensor
    final: Tensor

    FINALISTS = 8  # fittest motions that are tried in the last round; the best one by the mean wins
    LAST_ROUND: float  # share of a round, at its end, in which robots try the fittest few motions
    SHOWN: float  # share of a round, at its end, in which all robots try the winner, for a policy to learn it from

    def __init__(self, num_robots: int, trials: Trials, unit: float) -> None:
        super().__init__()
        self._dt, self._unit, self.rounds = trials.control_dt, unit, trials.rounds
        self._limit = math.inf if trials.limit is None else trials.limit
        self._round = math.inf if trials.steps is None else trials.steps / trials.rounds
        # Return of the episode up to the last step, and control steps since the trial began: -1 before the first one,
        # WAITS between two rounds.
        self.register_buffer("last", torch.zeros(num_robots))
        self.register_buffer("age", torch.full((num_robots,), -1, dtype=torch.int64))
        # Control steps of the warm-up so far, and whether its end has begun.
        self.register_buffer("taken", torch.zeros((), dtype=torch.int64))
        self.register_buffer("final", torch.zeros((), dtype=torch.bool))
        # Control steps at which the round began.
        self.register_buffer("began", torch.zeros((), dtype=torch.int64))

    @property
    def _last_round(self) -> float:
        """Return the control steps after which robots try the fittest few motions."""
        return int(self.began) + (1.0 - self.LAST_ROUND) * self._round

    @property
    def _shown(self) -> float:
        """Return the control steps after which all robots try the winner."""
        last = math.isinf(self._round) or not self.SHOWN
        return math.inf if last else int(self.began) + round((1.0 - self.SHOWN) * self._round)

    @property
    def round_over(self) -> bool:
        """Return whether a round is over that is not the last one: its winner is known, and another may begin."""
        return int(self.taken) - int(self.began) >= self._round and self.steps_left > 0

    @property
    def steps_left(self) -> int:
        """Return the control steps of the rounds that may follow once the winner of one is known, 0 if none may."""
        if not self.final or not 0 < self._round < math.inf:
            return 0
        left = self.rounds - int(self.taken) / self._round
        # A round may be a few steps longer, until somebody looks.
        return round(left * self._round) if left > 0.5 else 0

    def go_on(self) -> None:
        """Begin another round, with the motions that are known; robots wait for a new episode, which they ask for."""
        self.began.copy_(self.taken)
        self.final.fill_(False)
        self.age.fill_(WAITS)

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
    def finalists(self) -> list[int]:
        """Return motions of the last round among which one can be chosen, the fittest first; none by default."""
        return []

    def choose(self, finalist: int | None) -> None:
        """Let a motion of the last round count as the fittest one; ``None`` for the one with the best mean."""

    @property
    def decides(self) -> bool:
        """Return whether in the next step all robots give up their trials and begin to try the winner."""
        return False

    @property
    def anew(self) -> Tensor | None:
        """Return which robots had best begin a new episode before the next step, bool ``[robots]``; or ``None``."""
        return None

    @abstractmethod
    def fittest_action(self, phase: Tensor, shown: Shown = NOTHING) -> Tensor:
        """Return the actions of the fittest motion after states of the given phases.

        Args:
            phase: Phase of the motion's clock, ``[*]`` (periods).
            shown: What observations of these states show, ``[*, ...]``.

        Returns:
            Actions, ``[*, A]``.
        """
