"""Conditions on evaluations: they rank policies, end a training, or let it begin again."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from gctd3.envs.settings import MOST_ROBOTS
from gctd3.errors import ConfigError, suggest

RECORDED = ("slip_speed", "height_from_home", "periodic_fraction", "torque_saturation")

# Columns of progress.csv; gctd3.evaluation.quantities has names, units and definitions of those of gaits.
COLUMNS = (
    "frames",
    "updates",
    "wall_s",
    "return_mean",
    "return_std",
    "velocity_mean",
    "distance_mean",
    "success_rate",
    "hip_correlation",
    "stride_hz",
    "flight_fraction",
    # Of the motion, which is recorded where a condition asks for one of them.
    *RECORDED,
    "diverged",
    "train_episodes",
    "restarts",
    # Of a task with a commanded velocity.
    "error_forward",
    "error_side",
    "error_turn",
    "followed_rate",
    "fall_rate",
    # Of jumps to a commanded height.
    "apex_mean",
    "apex_error",
    # Whether the policy met the conditions from other starts too, where that was tried: 1 or 0.
    "confirmed",
)


@dataclass(frozen=True)
class StopWhen:
    """Hold conditions on evaluations, which rank policies and can end the training or let it begin again.

    A policy that meets more of the conditions counts as better; among equals the higher return does.

    Attributes:
        at_least: Lowest values, by the name of the metric; ``None`` leaves a condition out.
        at_most: Highest values, by the name of the metric; ``None`` leaves a condition out.
        evaluations: Evaluations in a row that must meet all conditions to end the training; ``None`` to train on.
        confirm: Episodes, from starts that no evaluation uses, in which the policy that would end the training must
            meet all conditions once more; it is then the best one. 0 for none.
        restart_after: Frames without an evaluation that meets all conditions, after which the training begins again
            with new weights and an empty replay: random restarts, against seeds that settle on a bad gait. ``None`` for
            never.
    """

    at_least: Mapping[str, float | None] = field(default_factory=dict)
    at_most: Mapping[str, float | None] = field(default_factory=dict)
    evaluations: int | None = None
    confirm: int = 0
    restart_after: int | None = None

    def __post_init__(self) -> None:
        unknown = [name for name in (*self.at_least, *self.at_most) if name not in COLUMNS]
        if unknown:
            raise ConfigError(
                f"at_least and at_most know no metric {unknown[0]!r}.{suggest(unknown[0], COLUMNS)} "
                f"Accepted: {', '.join(COLUMNS)}."
            )
        if self.evaluations is not None and self.evaluations < 1:
            raise ConfigError(f"evaluations must be at least 1, or null, got {self.evaluations}.")
        if not 0 <= self.confirm <= MOST_ROBOTS:
            raise ConfigError(f"confirm must be at least 0 and at most {MOST_ROBOTS:,}, got {self.confirm}.")
        if self.restart_after is not None and self.restart_after < 1:
            raise ConfigError(f"restart_after must be at least 1, or null, got {self.restart_after}.")

    @property
    def of_motion(self) -> bool:
        """Return whether a condition is on a metric of :data:`RECORDED`, for which the motion has to be recorded."""
        return any(name in RECORDED for name in self.names)

    @property
    def names(self) -> list[str]:
        """Return the metrics on which there is a condition."""
        return [name for name, _ in (*_bounds(self.at_least), *_bounds(self.at_most))]

    def missed(self, metrics: Mapping[str, float]) -> list[str]:
        """Name the conditions that do not hold, with what was measured."""
        below = [(name, bound, "<") for name, bound in _bounds(self.at_least)]
        above = [(name, bound, ">") for name, bound in _bounds(self.at_most)]
        found = []
        for name, bound, sign in (*below, *above):
            value = metrics.get(name, math.nan)
            if not (value >= bound if sign == "<" else value <= bound):
                found.append(f"{name} undefined" if math.isnan(value) else f"{name} {value:.3g} {sign} {bound:g}")
        return found

    def reached(self, metrics: Mapping[str, float]) -> int:
        """Count the conditions that hold; an undefined metric meets none."""
        return len(self.names) - len(self.missed(metrics))

    def all_reached(self, metrics: Mapping[str, float]) -> bool:
        """Return whether all conditions hold."""
        return not self.missed(metrics)

    def ends_after(self, in_a_row: int) -> bool:
        """Return whether so many evaluations in a row that met all conditions end the training."""
        return self.evaluations is not None and in_a_row >= self.evaluations

    def score(self, metrics: Mapping[str, float]) -> float:
        """Return a score that ranks policies by the conditions that they meet, then by return."""
        return self.reached(metrics) + (1.0 + math.tanh(metrics["return_mean"] / 1e4)) / 2.0


def _bounds(conditions: Mapping[str, float | None]) -> list[tuple[str, float]]:
    return [(name, bound) for name, bound in conditions.items() if bound is not None]
