"""Gaits that follow a commanded velocity: feet go as the ground does below a body that moves as commanded."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
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

    A gait is less fit by :attr:`OFF` for each m/s by which robots move otherwise than commanded. Some commands are
    harder than others. So the fitness of a gait is what it earned beyond what is usual under its command: a
    least-squares fit of the rewards of the last trials to sizes of the command, see :meth:`_sizes`. While robots try
    the fittest few gaits again, what each of these is asked for is corrected by how half of its robots move, which do
    so without noise, as policies will.
    """

    places: Tensor
    results: Tensor
    asked: Tensor
    asked_so_far: Tensor
    command: Tensor
    held: Tensor
    off: Tensor
    settled: Tensor
    corrected: Tensor
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
    LAST_ROUND = 0.55  # so that there is time to correct each of the last gaits
    AGAIN = 0.15
    FALL = 4.0  # most falls come with changes of the command, and are rare: one in thirty trials is too many
    SETTLED = 1.5  # time for which a command has held when a robot is taken to move as it will (s)
    RIDGE = 0.1  # of that fit, in trials
    OFF = 2.0  # by which each m/s off the command lowers the fitness, as SLOW does
    TURN = 0.75  # m/s that count as much as 1 rad/s: of 0.15 m/s and 0.2 rad/s, within which a command is followed

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
        self.register_buffer("asked_so_far", torch.zeros(num_robots, self.SIZES))
        self.register_buffer("moments", self.RIDGE * torch.eye(self.SIZES))
        self.register_buffer("earnings", torch.zeros(self.SIZES))
        self.register_buffer("command", torch.full((num_robots, 3), math.nan))
        self.register_buffer("held", torch.zeros(num_robots, dtype=torch.int64))
        # Sum over the trial of how robots moved less the command once it had held, and the steps that this is of.
        self.register_buffer("off", torch.zeros(num_robots, 3))
        self.register_buffer("settled", torch.zeros(num_robots))
        # What gaits are asked for under the commands.
        self.register_buffer("corrected", torch.zeros(num_robots, 3))
        # Robots without noise while commands are corrected: half of those of each gait.
        self.register_buffer("steady", torch.arange(num_robots) // self.FINALISTS % 2 == 0, persistent=False)
        self.correction = CommandCorrection(num_robots)

    def _add_memory(self, count: int) -> None:
        super()._add_memory(count)
        self.register_buffer("results", torch.full((count,), -math.inf))
        self.register_buffer("asked", torch.zeros(count, self.SIZES))

    def forward(
        self,
        is_init: Tensor,
        returned: Tensor,
        position: Tensor | None = None,
        shown: Shown = NOTHING,
    ) -> Tensor:
        """Return the actions ``[robots, A]`` of the next step; see :meth:`.Evolution.forward`."""
        command = shown.command
        if command is not None and shown.velocity is not None:
            self._watch(is_init, command, shown.velocity)
            shown = replace(shown, command=self.corrected)
        action = super().forward(is_init, returned, position, shown)
        # The trial that this step belongs to may just have begun.
        goes_on = self.age > 1
        self.asked_so_far.copy_(torch.where(goes_on[:, None], self.asked_so_far, 0.0) + self._sizes(command))
        self.off.copy_(torch.where(goes_on[:, None], self.off, 0.0))
        self.settled.copy_(torch.where(goes_on, self.settled, 0.0))
        return action

    def fittest_action(self, phase: Tensor, shown: Shown = NOTHING) -> Tensor:
        """Return the actions ``[*, A]`` of the fittest gait after states; see :meth:`.Evolution.fittest_action`."""
        if shown.command is not None:
            gait = self.finalist[self._best].expand(len(shown.command))
            shown = replace(shown, command=self.correction(shown.command, gait))
        return super().fittest_action(phase, shown)

    def _watch(self, is_init: Tensor, command: Tensor, moved: Tensor) -> None:
        """Take in how robots move under commands that have held for a while, and correct those that follow."""
        # The velocity is that under the command before.
        changed = is_init | (command != self.command).any(dim=-1)
        known = ~changed & (self.held * self._dt >= self.SETTLED)
        self.off += torch.where(known[:, None], moved - command, 0.0)
        self.settled += known
        observed = known & self.steady & (self.finalist >= 0)
        if bool(observed.any()):
            seen = (values[observed] for values in (command, self.corrected, moved, self.finalist))
            self.correction.observe(*seen)
        if self.final and int(self.taken) % self._steps == self._steps - 1:
            self.correction.fit()
        self.held.copy_(torch.where(changed, 0, self.held + 1))
        self.command.copy_(command)
        # A command that holds is not corrected anew, so that it is known what was asked for.
        asked = self.correction(command, self.finalist)
        self.corrected.copy_(torch.where(changed[:, None], asked, self.corrected))

    def _begin_last_round(self) -> None:
        super()._begin_last_round()
        self.correction.forget()

    def _shaken(self, action: Tensor) -> Tensor:
        """Return actions ``[robots, A]`` with noise, of steady robots without in the last round."""
        return torch.where((self.final & self.steady)[:, None], action, super()._shaken(action))

    def _sizes(self, command: Tensor | None) -> Tensor:
        """Return numbers that tell how hard commands are: 1, whether it is to stand, and sizes, ``[n, 6]``."""
        if command is None:
            raise ValueError("Gaits that follow a command need it.")
        stands = (command == 0.0).all(dim=-1, keepdim=True).float()
        return torch.cat([torch.ones_like(stands), stands, command.abs(), command[:, :1].clamp(min=0.0)], dim=-1)

    def _judge(self, tried: Tensor, result: Tensor) -> Tensor:
        asked = self.asked_so_far / self.age.clamp(min=1)[:, None]
        off = self.off / self.settled.clamp(min=1.0)[:, None]
        result = result - self.OFF * (off[:, :2].norm(dim=-1) + self.TURN * off[:, 2].abs())
        forget = math.exp(-float(tried.sum()) / (self.MEMORY * len(tried)))
        fresh, earned = asked[tried], result[tried]
        self.moments.mul_(forget).add_(fresh.T @ fresh + (1.0 - forget) * self.RIDGE * torch.eye(self.SIZES))
        self.earnings.mul_(forget).add_(fresh.T @ earned)
        usual = torch.linalg.solve(self.moments, self.earnings)
        # Of a gait that was tried again the mean counts, in which the last trials weigh most but for the last round.
        again = tried & self.again
        share = self._share(again)
        self._put(again, torch.lerp(self.results, result, share), torch.lerp(self.asked, asked, share[:, None]))
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
        half = 0.5 * time[:, None, None] / self._length * self._ground(gains * command)
        # All feet alike, so that a body that is slower than commanded goes the same way.
        farthest = half.norm(dim=-1).amax(dim=-1)[:, None, None]
        half = half * (self.REACH / farthest.clamp(min=self.REACH))
        fastest = self._ground(command).norm(dim=-1).amax(dim=-1, keepdim=True)
        return half, (fastest / (self.SLOW * math.sqrt(GRAVITY * self._length))).clamp(max=1.0)
