"""Gaits that follow a commanded velocity: feet go as the ground does below a body that moves as commanded."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from gctd3.data.command_correction import CommandCorrection
from gctd3.data.foot_paths import foot_places
from gctd3.data.stepping import Stepping
from gctd3.data.trials import NOTHING, Shown, Trials
from gctd3.robots.gait_pattern import GRAVITY, GaitPattern
from gctd3.robots.robot import Robot


class CommandedStepping(Stepping):
    """Generate gaits as :class:`.Stepping` does, whose steps go by the commanded velocity.

    Below a body that goes forward at ``v_x`` and to the left at ``v_y``, and turns at ``w``, the ground at a foot at
    ``(x, y)`` from the middle of the feet moves at ``-(v_x - w y, v_y + w x)``. A foot that is down for the share
    ``d`` of a period ``1 / f`` goes by that velocity times ``d / f``, half of it to either side of its place. Genes are
    factors of the three velocities, for feet slide and legs yield, and the genes of :class:`.Stepping` but the length
    of the steps. A command for which a leg would have to reach farther than there is followed more slowly. A robot that
    is to stand keeps its feet down.

    Some commands are harder than others. So the fitness of a gait is what it earned beyond what is usual under its
    command: a least-squares fit of the rewards of the last trials to sizes of the command, see :meth:`_sizes`. At the
    end of the warm-up all robots try the fittest gait, and what it is asked for is corrected by how half of them move,
    which do so without noise, as policies will.
    """

    places: Tensor
    results: Tensor
    asked: Tensor
    asked_so_far: Tensor
    command: Tensor
    held: Tensor
    correcting: Tensor
    steady: Tensor
    moments: Tensor
    earnings: Tensor

    GENES: ClassVar[Mapping[str, tuple[float, float, bool]]] = {
        "forward_gain": (0.7, 1.6, False),
        "side_gain": (0.7, 1.6, False),
        "turn_gain": (0.7, 2.0, False),
        **{name: bounds for name, bounds in Stepping.GENES.items() if name != "stride"},
    }
    REMEMBERED: ClassVar[tuple[str, ...]] = ("fitness", "results", "asked")
    SIZES = 6  # numbers that tell how hard a command is
    # Speed of the fastest foot over the ground from which on feet are lifted fully: the root of a Froude number.
    SLOW = 0.05
    REACH = Stepping.GENES["stride"][1]  # half of the longest way of a foot, leg lengths; farther, robots fall
    MEMORY = 4  # trials of each robot over which the usual reward of a command is fitted
    LAST_ROUND = 0.55  # share of the warm-up, at its end, in which gaits no longer evolve
    CORRECTED = 0.4  # share of the warm-up, at its end, in which commands are corrected
    SETTLED = 1.5  # time for which a command has held when a robot is taken to move as it will (s)
    RIDGE = 0.1  # of that fit, in trials

    def __init__(
        self,
        robot: Robot,
        num_robots: int,
        trials: Trials,
        gait: GaitPattern | None = None,
        balances: bool = False,
    ) -> None:
        super().__init__(robot, num_robots, trials, gait, balances)
        self.register_buffer("places", foot_places(robot), persistent=False)
        self.register_buffer("results", torch.full((num_robots,), -math.inf))
        self.register_buffer("asked", torch.zeros(num_robots, self.SIZES))
        self.register_buffer("asked_so_far", torch.zeros(num_robots, self.SIZES))
        self.register_buffer("moments", self.RIDGE * torch.eye(self.SIZES))
        self.register_buffer("earnings", torch.zeros(self.SIZES))
        self.register_buffer("command", torch.full((num_robots, 3), math.nan))
        self.register_buffer("held", torch.zeros(num_robots, dtype=torch.int64))
        self.register_buffer("correcting", torch.zeros((), dtype=torch.bool))
        # Robots without noise while commands are corrected: every second one, or all if there is one.
        self.register_buffer("steady", torch.arange(num_robots) % 2 == 0, persistent=False)
        self.correction = CommandCorrection()
        self._correct_from = math.inf if trials.steps is None else (1.0 - self.CORRECTED) * trials.steps

    def forward(
        self,
        is_init: Tensor,
        returned: Tensor,
        position: Tensor | None = None,
        shown: Shown = NOTHING,
    ) -> Tensor:
        """Return the actions ``[robots, A]`` of the next step; see :meth:`.Evolution.forward`."""
        if shown.command is not None and shown.velocity is not None:
            self._correct(is_init, shown.command, shown.velocity)
        action = super().forward(is_init, returned, position, shown)
        # The trial that this step belongs to may just have begun.
        self.asked_so_far.copy_(
            torch.where((self.age > 1)[:, None], self.asked_so_far, 0.0) + self._sizes(shown.command)
        )
        return action

    def _correct(self, is_init: Tensor, command: Tensor, moved: Tensor) -> None:
        """Let all robots try the fittest gait at the end of the warm-up, and correct what it is asked for."""
        # The velocity is that under the command before.
        changed = is_init | (command != self.command).any(dim=-1)
        known = self.correcting & self.steady & ~changed & (self.held * self._dt >= self.SETTLED)
        if bool(known.any()):
            self.correction.observe(command[known], moved[known])
        self.held.copy_(torch.where(changed, 0, self.held + 1))
        self.command.copy_(command)
        if not self.correcting and self.final and int(self.taken) >= self._correct_from:
            self.correcting.fill_(True)
            for name, value in self._fittest(len(is_init)).items():
                getattr(self, f"best_{name}").copy_(value.clone())
                getattr(self, name).copy_(value)
        elif self.correcting and (int(self.taken) - math.ceil(self._correct_from)) % self._steps == self._steps - 1:
            self.correction.end_round()

    def _shaken(self, action: Tensor) -> Tensor:
        """Return actions ``[robots, A]`` with noise, of steady robots without while commands are corrected."""
        return torch.where((self.correcting & self.steady)[:, None], action, super()._shaken(action))

    def _sizes(self, command: Tensor | None) -> Tensor:
        """Return numbers that tell how hard commands are: 1, whether it is to stand, and sizes, ``[n, 6]``."""
        if command is None:
            raise ValueError("Gaits that follow a command need it.")
        stands = (command == 0.0).all(dim=-1, keepdim=True).float()
        return torch.cat([torch.ones_like(stands), stands, command.abs(), command[:, :1].clamp(min=0.0)], dim=-1)

    def _judge(self, tried: Tensor, result: Tensor) -> Tensor:
        asked = self.asked_so_far / self.age.clamp(min=1)[:, None]
        forget = math.exp(-float(tried.sum()) / (self.MEMORY * len(tried)))
        fresh, earned = asked[tried], result[tried]
        self.moments.mul_(forget).add_(fresh.T @ fresh + (1.0 - forget) * self.RIDGE * torch.eye(self.SIZES))
        self.earnings.mul_(forget).add_(fresh.T @ earned)
        usual = torch.linalg.solve(self.moments, self.earnings)
        # Of a gait that was tried again the mean counts, in which the last trials weigh most.
        again = tried & self.again
        self._put(again, 0.5 * (self.results + result), 0.5 * (self.asked + asked))
        fitter = tried & ~again & (result - asked @ usual > self.results - self.asked @ usual)
        self._put(fitter, result, asked)
        # What is usual has changed for all.
        self.fitness.copy_(self.results - self.asked @ usual)
        return fitter

    def _put(self, mask: Tensor, results: Tensor, asked: Tensor) -> None:
        self.results.copy_(torch.where(mask, results, self.results))
        self.asked.copy_(torch.where(mask[:, None], asked, self.asked))

    def _ground(self, command: Tensor) -> Tensor:
        """Return how fast a body that moves as commanded goes over the ground at each foot, ``[n, feet, 2]`` (m/s)."""
        forward, side, turn = command[:, :1], command[:, 1:2], command[:, 2:]
        return torch.stack([forward - turn * self.places[:, 1], side + turn * self.places[:, 0]], dim=-1)

    def _steps_of(self, genes: Mapping[str, Tensor], command: Tensor | None) -> tuple[Tensor, Tensor]:
        if command is None:
            raise ValueError("Gaits that follow a command need it.")
        gains = torch.stack([genes[f"{axis}_gain"] for axis in ("forward", "side", "turn")], dim=-1)
        time = genes["duty"] / (self._unit * genes["frequency"])  # for which a foot is down (s)
        half = 0.5 * time[:, None, None] / self._length * self._ground(gains * self.correction(command))
        # All feet alike, so that a body that is slower than commanded goes the same way.
        farthest = half.norm(dim=-1).amax(dim=-1)[:, None, None]
        half = half * (self.REACH / farthest.clamp(min=self.REACH))
        fastest = self._ground(command).norm(dim=-1).amax(dim=-1, keepdim=True)
        return half, (fastest / (self.SLOW * math.sqrt(GRAVITY * self._length))).clamp(max=1.0)
