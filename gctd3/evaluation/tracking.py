"""How well robots follow commanded velocities."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gctd3.evaluation.episode import Episode
from gctd3.evaluation.settings import SETTLE

ERRORS = ("error_forward", "error_side", "error_turn")  # m/s, m/s, rad/s


def settled(command: np.ndarray, control_dt: float) -> np.ndarray:
    """Mark the steps that are counted: those for which a command has held for a second, bool ``[T]``.

    Args:
        command: Command of each step, shape ``[T, 3]``.
        control_dt: Control period (s).
    """
    new = np.ones(len(command), dtype=bool)
    new[1:] = (command[1:] != command[:-1]).any(axis=-1)
    steps = np.arange(len(command))
    since = steps - np.maximum.accumulate(np.where(new, steps, 0))
    return since >= round(SETTLE / control_dt)


def errors(episode: Episode, control_dt: float) -> np.ndarray | None:
    """Return the mean absolute error of each velocity over the counted steps, shape ``[3]`` (m/s, m/s, rad/s).

    ``None`` for a task without commands, or if no step counts.
    """
    if episode.command is None or episode.moved is None:
        return None
    counted = settled(episode.command, control_dt)
    return np.abs(episode.moved - episode.command)[counted].mean(axis=0) if counted.any() else None


def tracking_errors(episodes: Sequence[Episode], control_dt: float) -> dict[str, float]:
    """Average the errors of commanded velocities over episodes, with the share of falls; empty without commands.

    Errors are NaN if no episode lasted long enough.
    """
    if all(episode.command is None for episode in episodes):
        return {}
    each = [error for episode in episodes if (error := errors(episode, control_dt)) is not None]
    means = np.mean(each, axis=0) if each else np.full(len(ERRORS), np.nan)
    fell = float(np.mean([episode.fell for episode in episodes]))
    return {**dict(zip(ERRORS, map(float, means), strict=True)), "fall_rate": fell}
