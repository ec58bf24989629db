"""The result of a simulated walk."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass
class Walk:
    """Describe a simulated walk over ROS, or without it.

    Attributes:
        ended: How it ended: ``finish``, ``fall`` or ``time``.
        distance: Distance walked (m).
        steps: Control steps.
        period: Control period (s).
        qpos: Generalised positions at the end, shape ``[nq]``.
        round_trips: Time from each publication of readings to its command (s).
        late: Commands that came after a quarter of the control period, with the time of day.
        missed: Control periods without a command.
        refused: Messages that were refused.
    """

    ended: str
    distance: float
    steps: int
    period: float
    qpos: np.ndarray
    round_trips: list[float] = field(default_factory=list)
    late: int = 0
    missed: int = 0
    refused: int = 0

    @property
    def walked(self) -> bool:
        """Return whether the robot reached the finish, or was on its feet when the time was over."""
        return self.ended in ("finish", "time")

    def summary(self) -> str:
        """Describe the walk in two lines."""
        seconds = self.steps * self.period
        ends = {"finish": "reached the finish", "fall": "fell", "time": "was on its feet when the time was over"}
        lines = [
            f"The robot {ends[self.ended]}: {self.distance!r} m in {self.steps} steps, {seconds:.2f} s, "
            f"{self.distance / seconds:.3f} m/s."
        ]
        if self.round_trips:
            middle, most = np.quantile(self.round_trips, [0.5, 0.99]) * 1000
            lines.append(
                f"Round trip: median {middle:.2f} ms, 99th percentile {most:.2f} ms; commands late {self.late}, missed "
                f"{self.missed}, refused {self.refused}."
            )
        return "\n".join(lines)
