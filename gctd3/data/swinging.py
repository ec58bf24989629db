"""Open-loop gaits in which every joint follows a sine: they evolve during the warm-up by the training's reward."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import ClassVar

import torch
from torch import Tensor

from gctd3.data.evolution import Evolution
from gctd3.robots.robot import Robot


class Swinging(Evolution):
    """Generate open-loop gaits that evolve: every joint follows a sine, and its mirror image half a period later.

    A frequency, and for each pair of joints an offset, an amplitude and a phase are drawn, and evolve
    (:class:`.Evolution`). The only knowledge of walking in it is that legs take turns. A joint without a mirror image
    follows its own sine.

    Args:
        robot: The robot.
        num_robots: Number of robots.
        frequency: Lowest and highest frequency (Hz).
        trial: Time for which a gait is tried (s).
        control_dt: Control period (s).
        mutation_share: Share of new gaits that descend from others.
        steps: Control steps of the warm-up; ``None`` for one without an end.
        limit: Control steps after which an episode ends though the robot has not fallen; ``None`` for no such limit.
        least_speed: Speed below which a gait is less fit (m/s); ``None`` for the reward alone.
    """

    pair_of: Tensor
    lag: Tensor
    sign: Tensor

    GENES: ClassVar[Mapping[str, tuple[float, float, bool]]] = {
        "offset": (-0.5, 0.5, True),  # of a joint's half range
        "amplitude": (0.1, 1.0, True),  # of a joint's half range
        "phase": (0.0, 1.0, True),  # periods
    }
    # Larger, and among fewer rivals, than that of steps: with 0.07 a quarter of the seeds settle on gaits that fall.
    MUTATION = 0.1
    RIVALS = 4
    SHOWN = 0.15

    def __init__(
        self,
        robot: Robot,
        num_robots: int,
        frequency: Sequence[float],
        trial: float,
        control_dt: float,
        mutation_share: float = 0.8,
        steps: int | None = None,
        limit: int | None = None,
        least_speed: float | None = None,
    ) -> None:
        partner = torch.from_numpy(robot.action_mirror[0])
        own = torch.arange(len(partner))
        # In each pair the joint that the robot lists first leads, and the other lags by half a period.
        follows = own > partner
        leaders, pair_of = torch.unique(torch.minimum(own, partner), return_inverse=True)
        low, high = frequency
        genes = {"frequency": (low, high, False)}  # Hz
        pace = (trial, control_dt, mutation_share, steps)
        super().__init__(num_robots, len(leaders), *pace, least_speed=least_speed, limit=limit, genes=genes)
        sign = torch.where(follows, torch.from_numpy(robot.action_mirror[1]), 1.0).float()
        self.register_buffer("pair_of", pair_of, persistent=False)
        self.register_buffer("lag", 0.5 * follows, persistent=False)
        self.register_buffer("sign", sign, persistent=False)

    def act(
        self,
        genes: Mapping[str, Tensor],
        cycles: Tensor,
        command: Tensor | None = None,
        posture: Tensor | None = None,
    ) -> Tensor:
        """Return the actions ``[B, A]`` of gaits, which follow no command; see :meth:`.Evolution.act`."""
        offset, amplitude, phase = (genes[name][:, self.pair_of] for name in ("offset", "amplitude", "phase"))
        return self.sign * (offset + amplitude * torch.sin(2 * math.pi * (cycles[:, None] + phase + self.lag)))
