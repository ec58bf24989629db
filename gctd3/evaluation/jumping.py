"""How high robots jump, and how well they land."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gctd3.evaluation.episode import Episode


@dataclass(frozen=True)
class Level:
    """Hold how the jumps of one commanded height went.

    Attributes:
        commanded: Commanded height of the lowest sole above the ground at the apex (m).
        episodes: Number of episodes.
        success_rate: Share of them in which the robot stood at the end, after a jump that was high enough.
        fall_rate: Share of them in which it fell.
        apex_mean: Mean height of the apex (m).
        apex_least: Lowest apex (m).
        apex_most: Highest apex (m).
        rise_mean: Mean of the greatest height of the body from standing (m); the legs draw the soles up the rest.
    """

    commanded: float
    episodes: int
    success_rate: float
    fall_rate: float
    apex_mean: float
    apex_least: float
    apex_most: float
    rise_mean: float


def jump_errors(episodes: Sequence[Episode]) -> dict[str, float]:
    """Average the apex, its distance from the commanded height, and the falls; empty for a task without jumps."""
    jumps = [episode.jump for episode in episodes if episode.jump is not None]
    if not jumps:
        return {}
    asked, apex = np.array(jumps, dtype=np.float64).T
    return {
        "apex_mean": float(apex.mean()),
        "apex_error": float(np.abs(apex - asked).mean()),
        "fall_rate": float(np.mean([episode.fell for episode in episodes])),
    }


def by_level(episodes: Sequence[Episode]) -> list[Level]:
    """Summarise the episodes of each commanded height, the lowest first; empty for a task without jumps."""
    levels: dict[float, list[Episode]] = {}
    for episode in episodes:
        if episode.jump is not None:
            levels.setdefault(round(episode.jump[0], 9), []).append(episode)
    return [_level(commanded, levels[commanded]) for commanded in sorted(levels)]


def _level(commanded: float, episodes: Sequence[Episode]) -> Level:
    apex = np.array([episode.jump[1] for episode in episodes if episode.jump is not None])
    return Level(
        commanded=commanded,
        episodes=len(episodes),
        success_rate=float(np.mean([episode.success for episode in episodes])),
        fall_rate=float(np.mean([episode.fell for episode in episodes])),
        apex_mean=float(apex.mean()),
        apex_least=float(apex.min()),
        apex_most=float(apex.max()),
        rise_mean=float(np.mean([episode.height.max() for episode in episodes])),
    )
