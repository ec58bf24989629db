"""Posture of a body, as observations show it: what the reflexes of the warm-up's gaits answer to."""

from __future__ import annotations

import math

from gctd3.robots.array_library import array_namespace
from gctd3.robots.gait_pattern import GRAVITY
from gctd3.tasks.feature_table import FeatureTable
from gctd3.tasks.terms import Array

SENSES = ("pitch", "pitch_rate", "speed", "roll", "roll_rate", "drift")
# Readings that show each of them, and the sign with which they do: nose down, right side down, forward and to the left
# are positive. Gravity's direction has the sine of an angle.
READINGS: dict[str, tuple[tuple[str, float], ...]] = {
    "pitch": (("pitch_rad", 1.0), ("gravity_forward", 1.0)),
    "pitch_rate": (("pitch_rate_rad_s", 1.0),),
    "speed": (("velocity_m_s", 1.0), ("heading_forward_m_s", 1.0)),
    "roll": (("roll_rad", 1.0), ("gravity_side", -1.0)),
    "roll_rate": (("roll_rate_rad_s", 1.0),),
    "drift": (("side_rate_m_s", 1.0), ("heading_side_m_s", 1.0)),
}


class Posture:
    """Read how a body tilts and moves from observations.

    Angles are in rad; rates and speeds are in units of a pendulum as long as the legs, ``sqrt(g / L)`` and
    ``sqrt(g L)``, so that the same numbers serve robots of all sizes.

    Args:
        table: Features of the nodes.
        history: Frames of an observation, of which the last is the newest.
        leg_length: Length ``L`` of the legs (m).

    Attributes:
        observed: Whether each of ``SENSES`` is observed.
    """

    def __init__(self, table: FeatureTable, history: int, leg_length: float) -> None:
        self._first = (history - 1) * table.width
        rate, speed = math.sqrt(GRAVITY / leg_length), math.sqrt(GRAVITY * leg_length)
        units = {"pitch_rate": rate, "roll_rate": rate, "speed": speed, "drift": speed}
        self._places = [self._place(table, sense, units.get(sense, 1.0)) for sense in SENSES]
        self.observed = tuple(place is not None for place in self._places)

    @staticmethod
    def _place(table: FeatureTable, sense: str, unit: float) -> tuple[int, int, float] | None:
        shown = {one.name for row in table.readings for one in row if one is not None}
        for reading, sign in READINGS[sense]:
            if reading in shown:
                return (*table.place(reading), sign / unit)
        return None

    def __call__(self, nodes: Array) -> Array:
        """Return the senses.

        Args:
            nodes: Observations of the nodes, ``[*, N, F * H]``, of NumPy or PyTorch.

        Returns:
            Senses in the order of ``SENSES``, ``[*, 6]``; NaN for what is not observed.
        """
        xp = array_namespace(nodes)
        nothing = xp.full_like(nodes[..., 0, 0], math.nan)
        newest = nodes[..., self._first :]
        return xp.stack(
            [nothing if place is None else newest[..., place[0], place[1]] * place[2] for place in self._places],
            axis=-1,
        )
