"""What to ask of a gait so that the robot moves as commanded: from how robots moved when they were asked."""

from __future__ import annotations

from itertools import combinations_with_replacement

import torch
from torch import Tensor


class CommandCorrection(torch.nn.Module):
    """Correct the commands that gaits are given by how robots moved under what was asked of them.

    Feet slide, legs yield, a body that goes backward and to the side at once also turns, one that goes fast turns less,
    and a gait on the spot may creep. So the difference between what a gait was asked for and how the robot moved is
    fitted to a constant, the asked velocities and their products of two and three, by least squares in which later
    observations weigh more. What to ask for under a command is where this model then moves as commanded. It is looked
    for not far beyond the commands: a gait that cannot go as fast would be asked for ever more, and fall. A command to
    stand is left alone.

    Args:
        gaits: Number of gaits, each of which has its own correction.
    """

    correction: Tensor
    moments: Tensor
    errors: Tensor
    farthest: Tensor
    factors: Tensor

    # Axes of the factors of each term; 3 stands for the factor 1.
    TERMS = tuple(axes for degree in range(4) for axes in combinations_with_replacement(range(3), degree))
    RIDGE = 0.01  # of the fit, in mean squares of each term
    MEMORY = 0.85  # weight of what was observed before the last fit, in the next one
    FARTHEST = 2.0  # times the largest command of an axis, beyond which nothing is asked for
    STEPS, STEP = 16, 0.5  # of the search: their number, and the share of the difference that each of them makes up

    def __init__(self, gaits: int) -> None:
        super().__init__()
        terms = len(self.TERMS)
        padded = [axes + (3,) * (3 - len(axes)) for axes in self.TERMS]
        self.register_buffer("factors", torch.tensor(padded), persistent=False)
        self.register_buffer("correction", torch.zeros(gaits, terms, 3))
        self.register_buffer("moments", torch.zeros(gaits, terms, terms))
        self.register_buffer("errors", torch.zeros(gaits, terms, 3))
        self.register_buffer("farthest", torch.zeros(3))

    def forward(self, command: Tensor, gait: Tensor) -> Tensor:
        """Return what to ask of gaits under commands.

        Args:
            command: Commanded velocities, ``[n, 3]`` (m/s, m/s, rad/s).
            gait: Number of each one's gait, ``[n]``; below 0 the command is not corrected.

        Returns:
            Velocities, ``[n, 3]`` (m/s, m/s, rad/s).
        """
        known = gait >= 0
        if not bool(known.any()):
            return command
        correction = torch.where(known[:, None, None], self.correction[gait.clamp(min=0)], 0.0)
        bound = torch.maximum(self.FARTHEST * self.farthest, command.abs())
        asked = command
        for _ in range(self.STEPS):
            moved = asked + torch.einsum("nt,nta->na", self._terms(asked), correction)
            asked = (asked + self.STEP * (command - moved)).clamp(-bound, bound)
        return torch.where((command != 0.0).any(dim=-1, keepdim=True), asked, command)

    def observe(self, command: Tensor, asked: Tensor, moved: Tensor, gait: Tensor) -> None:
        """Take in how robots moved when their gaits were asked for velocities under commands.

        Args:
            command: Commanded velocities, ``[n, 3]`` (m/s, m/s, rad/s).
            asked: What their gaits were asked for, ``[n, 3]``.
            moved: How they moved, ``[n, 3]``.
            gait: Number of each one's gait, ``[n]``; others than those at 0 and above are ignored.
        """
        walks = (gait >= 0) & (command != 0.0).any(dim=-1)
        command, asked, moved, gait = command[walks], asked[walks], moved[walks], gait[walks]
        terms = self._terms(asked)
        self.moments.index_add_(0, gait, torch.einsum("nt,nu->ntu", terms, terms))
        self.errors.index_add_(0, gait, torch.einsum("nt,na->nta", terms, moved - asked))
        if len(command):
            self.farthest.copy_(torch.maximum(self.farthest, command.abs().amax(dim=0)))

    def fit(self) -> None:
        """Compute the corrections of those gaits that were observed."""
        spread = self.moments.diagonal(dim1=-2, dim2=-1)
        seen = (spread > 0).any(dim=-1)
        # A term that nothing asked for has had stays out of the fit.
        ridge = torch.diag_embed(torch.where(spread > 0, self.RIDGE * spread, 1.0))[seen]
        self.correction[seen] = torch.linalg.solve(self.moments[seen] + ridge, self.errors[seen])
        self.moments.mul_(self.MEMORY)
        self.errors.mul_(self.MEMORY)

    def forget(self) -> None:
        """Forget all that was observed, and correct nothing."""
        for values in (self.correction, self.moments, self.errors):
            values.zero_()

    def _terms(self, asked: Tensor) -> Tensor:
        """Return 1, each velocity and their products of two and three, ``[n, 20]``."""
        return torch.nn.functional.pad(asked, (0, 1), value=1.0)[:, self.factors].prod(dim=-1)
