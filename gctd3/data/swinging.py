"""Open-loop gaits in which every joint follows a sine: they evolve during the warm-up by the training's reward."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import ClassVar

import torch
from torch import Tensor

from gctd3.data.evolution import Evolution
from gctd3.data.joint_pairs import JointPairs
from gctd3.data.trials import NOTHING, Shown, Trials
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
        trials: How gaits are tried.
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

    def __init__(self, robot: Robot, num_robots: int, frequency: Sequence[float], trials: Trials) -> None:
        # In each pair the joint that leads is half a period ahead of the other.
        pairs = JointPairs.of(robot)
        low, high = frequency
        genes = {"frequency": (low, high, False)}  # Hz
        super().__init__(num_robots, len(pairs.leaders), trials, genes=genes)
        self.register_buffer("pair_of", pairs.pair_of, persistent=False)
        self.register_buffer("lag", 0.5 * pairs.follows, persistent=False)
        self.register_buffer("sign", pairs.sign, persistent=False)

    def act(self, genes: Mapping[str, Tensor], cycles: Tensor, shown: Shown = NOTHING) -> Tensor:
        """Return the actions ``[B, A]`` of gaits, which follow no command; see :meth:`.Evolution.act`."""
        offset, amplitude, phase = (genes[name][:, self.pair_of] for name in ("offset", "amplitude", "phase"))
        return self.sign * (offset + amplitude * torch.sin(2 * math.pi * (cycles[:, None] + phase + self.lag)))
