"""What to ask of a gait so that the robot moves as commanded: measured, and corrected in rounds."""

from __future__ import annotations

from itertools import combinations_with_replacement

import torch
from torch import Tensor


class CommandCorrection(torch.nn.Module):
    """Correct the commands that a gait is given by how the robot moved under them.

    Feet slide, legs yield, a body that goes backward and to the side at once also turns, one that goes fast turns less,
    and a gait on the spot may creep. So the error of the velocity is fitted to a constant, the command and its products
    of two and three, by least squares over all robots, and taken off what the gait is asked for. After several rounds
    little is left: iterative learning control (Arimoto et al. 1984). The ``k``-th round takes off ``1 / k`` of what it
    found, so that the noise of the rounds averages out. A command to stand is left alone.
    """

    correction: Tensor
    moments: Tensor
    errors: Tensor
    rounds: Tensor

    # Axes of the factors of each term.
    TERMS = tuple(axes for degree in range(4) for axes in combinations_with_replacement(range(3), degree))
    RIDGE = 0.01  # of the fit, in mean squares of each term

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("correction", torch.zeros(len(self.TERMS), 3))
        self.register_buffer("moments", torch.zeros(len(self.TERMS), len(self.TERMS)))
        self.register_buffer("errors", torch.zeros(len(self.TERMS), 3))
        self.register_buffer("rounds", torch.zeros((), dtype=torch.int64))

    def forward(self, command: Tensor) -> Tensor:
        """Return what to ask of the gait, ``[*, 3]``, under commands ``[*, 3]`` (m/s, m/s, rad/s)."""
        return command - self._terms(command) @ self.correction

    def observe(self, command: Tensor, moved: Tensor) -> None:
        """Take in how robots moved, ``[n, 3]``, under commands ``[n, 3]`` (m/s, m/s, rad/s)."""
        terms = self._terms(command)
        self.moments.add_(terms.T @ terms)
        self.errors.add_(terms.T @ (moved - command))

    def end_round(self) -> None:
        """Correct the commands by what was observed since the last round, if that was enough to tell."""
        # A term that no command has had stays out of the fit.
        spread = self.moments.diagonal()
        if not bool((spread > 0).any()):
            return
        ridge = torch.diag(torch.where(spread > 0, self.RIDGE * spread, 1.0))
        self.rounds += 1
        self.correction.add_(torch.linalg.solve(self.moments + ridge, self.errors) / self.rounds)
        self.moments.zero_()
        self.errors.zero_()

    @classmethod
    def _terms(cls, command: Tensor) -> Tensor:
        """Return 1, each command and its products of two and three, ``[*, 20]``; zeros for a command to stand."""
        terms = torch.stack([command[..., list(axes)].prod(dim=-1) for axes in cls.TERMS], dim=-1)
        return terms * (command != 0.0).any(dim=-1, keepdim=True)
