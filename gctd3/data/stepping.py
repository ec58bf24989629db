"""Gaits whose feet step: they evolve during the warm-up, and training starts from their transitions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from gctd3.data.evolution import Evolution
from gctd3.data.foot_paths import foot_arcs, foot_groups, foot_height, foot_places, foot_way, joint_paths
from gctd3.data.reflexes import GENES as REFLEXES
from gctd3.data.reflexes import NONE_AT_FIRST, reflexes
from gctd3.data.trials import NOTHING, Shown, Trials
from gctd3.robots.gait_pattern import GRAVITY, GaitPattern
from gctd3.robots.robot import Robot
from gctd3.tasks.posture import SENSES


class Stepping(Evolution):
    """Generate gaits in which every foot moves to and fro and is lifted on its way forwards.

    The path of a foot about its place in the standing pose becomes joint angles by the pseudo-inverse of its leg's
    Jacobian, less the arc that it would go along. On the ground a foot moves as the ground does below a body of
    constant speed, and it touches down and lifts off at that speed, so that it need not slide. Left and right feet
    step half a period apart; the phases of the pairs, frequency, length and height of the steps, a shift of each pair
    of feet, a crouch and a sway are drawn, and evolve (:class:`.Evolution`). Lengths are in leg lengths and frequencies
    in those of a pendulum as long as the leg, so that the same numbers serve robots of all sizes.

    The gaits are open-loop ones unless they have reflexes: then feet answer to the body's posture (:func:`.reflexes`),
    with gains that evolve too, and legs with joints enough keep their soles level.

    Args:
        robot: The robot.
        num_robots: Number of robots.
        trials: How gaits are tried.
        gait: Frequency and phases of the feet of all gaits; they evolve if ``None``.
        balances: Whether gaits have reflexes.

    Raises:
        ConfigError: If no foot has a driven joint of its own.
    """

    pair_of: Tensor
    lagging: Tensor
    left: Tensor
    joints: Tensor
    arc: Tensor

    # Lowest and highest value of each gene, and whether each pair of feet has its own; reflexes have more.
    GENES: ClassVar[Mapping[str, tuple[float, float, bool]]] = {
        "frequency": (1.0, 3.2, False),  # of a pendulum as long as the leg
        "stride": (0.05, 0.45, False),  # half of a foot's way to and fro, leg lengths
        "lift": (0.05, 0.5, False),  # leg lengths
        "duty": (0.5, 0.75, False),  # share of a period in which a foot goes backwards
        "softness": (1.0, 2.0, False),  # of lifting off and touching down: power of the sine of the height
        "lead": (-0.05, 0.15, False),  # of the way, since servos take their time; periods
        "lag": (-0.1, 0.1, False),  # of the lift, periods; below 0 it is later
        "crouch": (-0.2, 0.1, False),  # leg lengths; below 0 legs stretch against what they carry
        "sway": (-0.1, 0.1, False),  # of the body to the side, leg lengths
        "sway_phase": (0.0, 1.0, False),  # periods
        "shift": (-0.15, 0.15, True),  # of a pair of feet forwards, leg lengths
        "phase": (0.0, 1.0, True),  # of a pair of feet, periods
    }
    CYCLIC = ("phase", "sway_phase")
    ALIKE = True
    DAMPING = 0.05  # of the pseudo-inverse, leg lengths

    def __init__(
        self,
        robot: Robot,
        num_robots: int,
        trials: Trials,
        gait: GaitPattern | None = None,
        balances: bool = False,
    ) -> None:
        length = robot.leg_length
        pendulum = math.sqrt(GRAVITY / length) / (2 * math.pi)
        group, lag = foot_groups(robot)
        groups, fixed = int(group.max()) + 1, dict[str, Tensor]()
        if gait is not None:
            # Of a robot whose feet are no mirror images, each foot has the phase that the gait gives it.
            phases = torch.from_numpy(gait.phases).float()
            firsts = phases[[int((group == pair).nonzero()[0]) for pair in range(groups)]]
            lag = phases - firsts[group]
            fixed = {"frequency": torch.tensor(gait.frequency / pendulum), "phase": firsts}
        super().__init__(num_robots, groups, trials, pendulum, fixed, REFLEXES if balances else None)
        self.balances, self._length = balances, length
        self.register_buffer("pair_of", group, persistent=False)
        self.register_buffer("lagging", lag, persistent=False)
        self.register_buffer("joints", joint_paths(robot, self.DAMPING * length, balances), persistent=False)
        self.register_buffer("arc", foot_arcs(robot, self.joints), persistent=False)
        self.register_buffer("left", foot_places(robot)[:, 1].sign(), persistent=False)

    def _draw(self, count: int) -> dict[str, Tensor]:
        drawn = super()._draw(count)
        for name in REFLEXES if self.genes.keys() >= REFLEXES.keys() else ():
            drawn[name] *= torch.rand(count) >= NONE_AT_FIRST
        return drawn

    def act(self, genes: Mapping[str, Tensor], cycles: Tensor, shown: Shown = NOTHING) -> Tensor:
        """Return the actions ``[B, A]`` of gaits; see :meth:`.Evolution.act`."""
        phase = cycles[:, None] + genes["phase"][:, self.pair_of] + self.lagging
        lead, lag, duty, softness = (genes[name][:, None] for name in ("lead", "lag", "duty", "softness"))
        way, lift = foot_way(phase + lead, duty), foot_height(phase + lag, softness)
        sway = genes["sway"] * torch.sin(2 * math.pi * (cycles + genes["sway_phase"]))
        half, amount = self._steps_of(genes, shown.command)
        forward = genes["shift"][:, self.pair_of] + half[..., 0] * way
        side = half[..., 1] * way + amount * sway[:, None]
        up = genes["crouch"][:, None] + amount * genes["lift"][:, None] * lift
        if not self.balances:
            moved = torch.stack([forward, side, up - self.arc * forward.square()], dim=-1)
            return torch.einsum("nfd,fda->na", self._length * moved, self.joints)
        if (posture := shown.posture) is None:
            raise ValueError("Gaits with reflexes need the body's posture.")
        answer = reflexes(genes, posture - self._steady(genes, half, posture), lift, self.left)
        forward, side, up = (path + answer[..., k] for k, path in enumerate((forward, side, up)))
        moved = torch.stack([forward, side, up - self.arc * forward.square()], dim=-1)
        return torch.einsum("nfd,fda->na", torch.cat([self._length * moved, answer[..., 3:]], dim=-1), self.joints)

    @staticmethod
    def _steady(genes: Mapping[str, Tensor], half: Tensor, posture: Tensor) -> Tensor:
        """Return the posture of the steady gait: upright, at the velocity at which feet push the ground back."""
        # Half of a foot's way in a stance, in units of a pendulum as long as the leg.
        velocity = half.mean(dim=1) * (genes["frequency"] / (math.pi * genes["duty"]))[:, None]
        steady = torch.zeros_like(posture)
        steady[:, SENSES.index("speed")], steady[:, SENSES.index("drift")] = velocity.unbind(-1)
        return steady

    def _steps_of(self, genes: Mapping[str, Tensor], command: Tensor | None) -> tuple[Tensor, Tensor]:
        """Return the steps of gaits: half of each foot's way, and how much of lift and sway there is.

        Returns:
            Half of the way forward and to the left, broadcast to ``[n, feet, 2]`` (leg lengths), and a share of
            broadcast ``[n, feet]``.
        """
        stride = genes["stride"]
        return torch.stack([stride, torch.zeros_like(stride)], dim=-1)[:, None], torch.ones(1, 1)
