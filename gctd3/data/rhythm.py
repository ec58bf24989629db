"""Random gaits of a warm-up: every joint follows a sine, left and right half a period apart."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from gctd3.robots.robot import Robot


class Rhythm(torch.nn.Module):
    """Generate open-loop gaits: every joint follows a sine, and its mirror image follows it half a period later.

    Each episode draws a frequency, and for each pair of joints an offset, an amplitude and a phase. The only
    knowledge of walking in it is that legs take turns; most draws fall, a few step forward, and the critic starts from
    those. A joint without a mirror image follows its own sine.

    With ``mutation_share`` the gaits evolve: every robot remembers its gait that got farthest, and that share of new
    gaits are mutations: the parent of each is the farthest of the gaits that a few random robots remember. So a robot
    that has to balance, which hardly any random gait does, soon tries gaits that do.

    Args:
        robot: The robot.
        num_robots: Number of robots.
        frequency: Lowest and highest frequency (Hz).
        control_dt: Control period (s).
        mutation_share: Share of new gaits that descend from others.
    """

    leader: Tensor
    lag: Tensor
    sign: Tensor
    offset: Tensor
    amplitude: Tensor
    phase: Tensor
    cycles: Tensor
    frequency: Tensor
    farthest: Tensor

    OFFSET = 0.5  # largest, of a joint's half range
    AMPLITUDE = (0.1, 1.0)  # smallest and largest, of a joint's half range
    NOISE = 0.1  # standard deviation of the noise on the sines
    RIVALS = 4  # robots of whom the one that got farthest is a parent
    # Standard deviations of mutations: in a joint's half range, in a period, in Hz.
    MUTATION: Mapping[str, float] = {"offset": 0.1, "amplitude": 0.1, "phase": 0.04, "frequency": 0.1}

    def __init__(
        self, robot: Robot, num_robots: int, frequency: Sequence[float], control_dt: float, mutation_share: float = 0.0
    ) -> None:
        super().__init__()
        partner = torch.from_numpy(robot.action_mirror[0])
        own = torch.arange(len(partner))
        # In each pair the joint that the robot lists first leads, and the other lags by half a period.
        self.register_buffer("leader", torch.minimum(own, partner))
        self.register_buffer("lag", 0.5 * (own > partner))
        self.register_buffer("sign", torch.where(own > partner, torch.from_numpy(robot.action_mirror[1]), 1.0).float())
        for name in ("offset", "amplitude", "phase"):
            self.register_buffer(name, torch.zeros(num_robots, len(partner)))
        self.register_buffer("cycles", torch.zeros(num_robots))
        self.register_buffer("frequency", torch.zeros(num_robots))
        self._range, self._dt, self._mutation_share = tuple(frequency), control_dt, mutation_share
        if mutation_share:
            self.register_buffer("farthest", torch.full((num_robots,), -math.inf))
            for name in self.MUTATION:
                self.register_buffer(f"best_{name}", torch.zeros_like(getattr(self, name)))

    def draw(self, mask: Tensor) -> None:
        """Draw new gaits for the robots where ``mask`` (bool ``[robots]``) holds."""
        shape = self.phase.shape
        pair = (slice(None), self.leader)
        new = {
            "offset": (2 * torch.rand(shape) - 1)[pair] * self.OFFSET,
            "amplitude": self.AMPLITUDE[0] + (self.AMPLITUDE[1] - self.AMPLITUDE[0]) * torch.rand(shape)[pair],
            "phase": torch.rand(shape)[pair] + self.lag,
            "cycles": torch.zeros(shape[0]),
            "frequency": self._range[0] + (self._range[1] - self._range[0]) * torch.rand(shape[0]),
        }
        for name, values in new.items():
            self._put(name, mask, values)
        if self._mutation_share:
            self._mutate(mask & (torch.rand(len(mask)) < self._mutation_share))

    def _mutate(self, mask: Tensor) -> None:
        rivals = torch.randint(len(mask), (len(mask), self.RIVALS))
        parent = rivals.gather(1, self.farthest[rivals].argmax(dim=1, keepdim=True))[:, 0]
        mask = mask & self.farthest[parent].isfinite()
        limits = {"offset": (-1.0, 1.0), "amplitude": self.AMPLITUDE, "frequency": self._range}
        for name, size in self.MUTATION.items():
            values = getattr(self, f"best_{name}")[parent]
            change = size * torch.randn_like(values)
            values = values + (change if name == "frequency" else change[:, self.leader])
            self._put(name, mask, values.clamp(*limits[name]) if name in limits else values)

    def _put(self, name: str, mask: Tensor, values: Tensor) -> None:
        old = getattr(self, name)
        old.copy_(torch.where(mask.reshape(-1, *[1] * (old.ndim - 1)), values, old))

    def remember(self, position: Tensor) -> None:
        """Record distance ``[robots]`` (m) and gait of each robot that has got farther than before."""
        farther = position > self.farthest
        self._put("farthest", farther, position)
        for name in self.MUTATION:
            self._put(f"best_{name}", farther, getattr(self, name))

    def forward(self, is_init: Tensor, position: Tensor | None = None) -> Tensor:
        """Return the actions ``[robots, A]`` of the next step; robots whose episode begins get a new gait first.

        Args:
            is_init: Robots whose episode begins, bool ``[robots]``.
            position: Distance walked, ``[robots]`` (m); needed only with mutation_share.
        """
        if self._mutation_share and position is not None:
            self.remember(torch.where(is_init, -math.inf, position))
        if is_init.any():
            self.draw(is_init)
        self.cycles += self._dt * self.frequency
        wave = torch.sin(2 * math.pi * (self.cycles[:, None] + self.phase))
        action = self.sign * (self.offset + self.amplitude * wave)
        return (action + self.NOISE * torch.randn_like(action)).clamp(-1.0, 1.0)
