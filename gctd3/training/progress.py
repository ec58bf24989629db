"""The progress of a training."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Counters:
    """Count the progress of a training.

    Attributes:
        frames: Control steps of single robots so far.
        updates: Updates of the networks.
        episodes: Episodes that ended.
        diverged: Episodes that ended because the simulation did not stay finite.
        in_a_row: Evaluations in a row that met all conditions.
        restarts: Times that the training began again with new weights.
        promising: Frames at which the training began (again), or at which an evaluation last met all conditions.
        next_evaluation: Frames at which the next evaluation is due.
        wall_s: Seconds spent, before and after every resumption together.
    """

    frames: int = 0
    updates: int = 0
    episodes: int = 0
    diverged: int = 0
    in_a_row: int = 0
    restarts: int = 0
    promising: int = 0
    next_evaluation: int = 0
    wall_s: float = 0.0
