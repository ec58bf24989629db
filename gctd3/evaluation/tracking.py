"""How well robots follow commanded velocities."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from gctd3.evaluation.episode import Episode
from gctd3.evaluation.settings import SETTLE

ERRORS = ("error_forward", "error_side", "error_turn")  # m/s, m/s, rad/s


WITHIN = 0.3  # mean absolute error in the plane up to which an episode counts as tracked (m/s)
NEAR, TURN_NEAR = 0.15, 0.2  # of the mean velocity to a command that is followed (m/s, rad/s)


def is_near(off: np.ndarray) -> bool:
    """Return whether a mean velocity is near enough to its command to follow it.

    Args:
        off: Mean velocity less the command, shape ``[3]`` (m/s, m/s, rad/s).
    """
    return bool(np.hypot(off[0], off[1]) <= NEAR and abs(off[2]) <= TURN_NEAR)


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


def followed(episode: Episode, control_dt: float) -> list[bool]:
    """Return for each command of an episode, in their order, whether the robot followed it.

    The mean velocity, without the first second of the command, is near it, and the robot does not fall. Commands that
    ended before they counted are left out.
    """
    if episode.command is None or episode.moved is None:
        return []
    counted = settled(episode.command, control_dt)
    changes = np.flatnonzero((episode.command[1:] != episode.command[:-1]).any(axis=-1)) + 1
    bounds = [0, *changes.tolist(), len(episode.command)]
    result = []
    for start, end in itertools.pairwise(bounds):
        steps = np.arange(start, end)[counted[start:end]]
        fell = episode.fell and end == len(episode.command)
        if fell:
            result.append(False)
        elif len(steps):
            result.append(is_near((episode.moved - episode.command)[steps].mean(axis=0)))
    return result


def tracking_errors(episodes: Sequence[Episode], control_dt: float) -> dict[str, float]:
    """Average the errors of commanded velocities over episodes, with the shares of commands followed and of falls.

    ``tracked_rate`` is the share of episodes without a fall whose mean absolute error in the plane is at most 0.3 m/s.
    Errors are NaN if no episode lasted long enough. It is empty without commands.
    """
    if all(episode.command is None for episode in episodes):
        return {}
    each = [error for episode in episodes if (error := errors(episode, control_dt)) is not None]
    means = np.mean(each, axis=0) if each else np.full(len(ERRORS), np.nan)
    fell = float(np.mean([episode.fell for episode in episodes]))
    each_command = [one for episode in episodes for one in followed(episode, control_dt)]
    rate = float(np.mean(each_command)) if each_command else math.nan
    shares = {"followed_rate": rate, "fall_rate": fell, "tracked_rate": _tracked(episodes, control_dt)}
    return {**dict(zip(ERRORS, map(float, means), strict=True)), **shares}


def _tracked(episodes: Sequence[Episode], control_dt: float) -> float:
    known = [None if episode.fell else errors(episode, control_dt) for episode in episodes]
    return float(np.mean([error is not None and np.hypot(error[0], error[1]) <= WITHIN for error in known]))
