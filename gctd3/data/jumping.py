"""Jumps that evolve during the warm-up: lists of poses through which all legs go, for each commanded height its own."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from gctd3.data.joint_pairs import JointPairs
from gctd3.data.leg_poses import drawn_up, places_in_legs
from gctd3.data.motion_search import MotionSearch
from gctd3.data.separable_cma import SeparableCMA
from gctd3.data.trials import NOTHING, Shown, Trials
from gctd3.robots.robot import Robot

POSES = 6  # between the standing pose at the beginning and at the end
TUCKED = (3, 4)  # of them, in which legs are drawn up at first
TIMES = ((0.2, 0.5), (0.05, 0.12))  # shortest and longest time to the first pose, and between poses (s)


class Jumping(MotionSearch):
    """Generate open-loop jumps that evolve: a crouch, and a few poses after it at equal times, joined by lines.

    Left and right legs do the same. The only knowledge of jumping in it is that a robot begins and ends as it stands.
    A jump is tried for a whole episode, and its fitness is the episode's return, less a penalty if the robot falls.

    Each commanded height has a normal distribution of jumps of its own, which evolves by the separable CMA-ES (Ros &
    Hansen 2008, doi 10.1007/978-3-540-87700-4_30), a generation of about as many jumps as robots have the height in
    the time of an episode. In the last round robots try the fittest few of each height again, from their random
    starts, and the best one by the mean wins; at its end all robots try the winners, with noise.

    Args:
        robot: The robot.
        num_robots: Number of robots.
        levels: Commanded heights, rising, ``L`` of them (m).
        frequency: Frequency of the clock, which begins anew with each episode (Hz).
        trials: How jumps are tried; each is tried for an episode.
    """

    levels: Tensor
    home: Tensor
    pair_of: Tensor
    like: Tensor
    sign: Tensor
    level: Tensor
    slot: Tensor
    tried_now: Tensor
    elite: Tensor
    elite_fitness: Tensor
    total: Tensor
    count: Tensor
    result: Tensor
    result_level: Tensor
    results: Tensor
    filled: Tensor
    evolved: Tensor

    BEGIN = 0.3  # for which the robot stands first (s)
    SPREAD = 0.5  # standard deviation of the first poses about the standing one (actions)
    APART = 0.2  # the same of what legs that stand alike do differently
    NOISE = 0.02  # a jump is over before noise averages out
    SHOWN = 0.2  # in which all robots try the winners, so that policies learn them from states near theirs
    SHAKEN = 0.3  # largest noise in that time, spread over the robots (actions)
    MOST = 0.97  # largest action: policies reach 1 only with endless weights
    FALL = 3.0  # return
    OUTSIDE = 1.0  # return, by which the mean square of what is beyond the range of actions lowers the fitness
    LAST_ROUND = 0.35
    INJECTED = 0.1  # share of new jumps that are the fittest one of any height
    FEWEST = 6  # results of a level by which its distribution evolves

    def __init__(
        self, robot: Robot, num_robots: int, levels: Sequence[float], frequency: float, trials: Trials
    ) -> None:
        joints = JointPairs.of(robot)
        leaders, pair_of = joints.leaders, joints.pair_of
        super().__init__(num_robots, trials, frequency)
        centre, scale = robot.action_map
        names = [joint.name for joint in robot.joints]
        standing = robot.home_angles[[names.index(name) for name in robot.actuated]]
        home = torch.from_numpy(np.clip((standing - centre) / scale, -1.0, 1.0)).float()[leaders]
        like = pair_of[places_in_legs(robot)][leaders]
        constants = {"levels": torch.tensor(list(levels)), "home": home, "pair_of": pair_of, "like": like}
        constants["sign"] = joints.sign
        for name, values in constants.items():
            self.register_buffer(name, values, persistent=False)
        kinds, pairs = len(levels), len(leaders)
        apart = (like != torch.arange(pairs)).repeat(POSES)
        tuck = drawn_up(robot)[leaders]
        first = torch.where(apart, 0.0, torch.cat([tuck if i in TUCKED else home for i in range(POSES)]))
        length = len(TIMES) + len(first)
        spread = torch.cat([torch.full((len(TIMES),), self.SPREAD), torch.where(apart, self.APART, self.SPREAD)])
        state = {
            "level": torch.zeros(num_robots, dtype=torch.int64),
            "slot": torch.full((num_robots,), -1, dtype=torch.int64),
            "tried_now": torch.zeros(num_robots, length),
            "elite": torch.zeros(kinds, self.FINALISTS, length),
            "elite_fitness": torch.full((kinds, self.FINALISTS), -math.inf),
            "total": torch.zeros(kinds, self.FINALISTS),
            "count": torch.zeros(kinds, self.FINALISTS),
            # Jumps and results since the last generation, filled from the beginning.
            "results": torch.zeros(4 * num_robots, length),
            "result": torch.zeros(4 * num_robots),
            "result_level": torch.zeros(4 * num_robots, dtype=torch.int64),
            "filled": torch.zeros((), dtype=torch.int64),
            "evolved": torch.zeros((), dtype=torch.int64),  # control steps until the last generation
        }
        for name, values in state.items():
            self.register_buffer(name, values)
        self.search = SeparableCMA(torch.cat([torch.zeros(len(TIMES)), first]).expand(kinds, -1), spread)

    def poses(self, jumps: Tensor, time: Tensor) -> Tensor:
        """Return the actions ``[B, A]`` of jumps ``[B, D]`` at times ``[B]`` (s)."""
        low, high = torch.tensor(TIMES).T
        crouch, spacing = (low + (high - low) * (jumps[:, : len(TIMES)].clamp(-1.0, 1.0) + 1.0) / 2).T
        own = jumps[:, len(TIMES) :].reshape(len(jumps), POSES, -1)
        # What a leg does differently from the one that is like it.
        poses = torch.where(self.like == torch.arange(len(self.like)), own, own[..., self.like] + own).clamp(-1.0, 1.0)
        home = self.home.expand(len(jumps), 1, -1)
        poses = torch.cat([home, poses, home], dim=1)
        at = self.BEGIN + crouch[:, None] + spacing[:, None] * torch.arange(POSES + 1)
        at = torch.cat([torch.full_like(at[:, :1], self.BEGIN), at], dim=1)
        now = ((time[:, None] >= at).sum(dim=1, keepdim=True) - 1).clamp(0, POSES)
        begin, end = at.gather(1, now), at.gather(1, now + 1)
        share = ((time[:, None] - begin) / (end - begin)).clamp(0.0, 1.0)
        wide = now[..., None].expand(-1, 1, poses.shape[-1])
        pose = torch.lerp(poses.gather(1, wide)[:, 0], poses.gather(1, wide + 1)[:, 0], share)
        return (self.sign * pose[:, self.pair_of]).clamp(-self.MOST, self.MOST)

    def forward(
        self,
        is_init: Tensor,
        returned: Tensor,
        position: Tensor | None = None,
        shown: Shown = NOTHING,
    ) -> Tensor:
        """Return the actions ``[robots, A]`` of the next step; see :meth:`.MotionSearch.forward`."""
        if (command := shown.command) is None:
            raise ValueError("Jumps need the commanded height.")
        ended = is_init | (self.age < 0)
        if ended.any():
            self._take_in(ended & (self.age > 0))
            if int(self.taken - self.evolved) >= self._limit:
                self._evolve()
            self.level.copy_(torch.where(ended, self._level_of(command), self.level))
            self._begin_jumps(ended)
            self.age.copy_(torch.where(ended, 0, self.age))
        self.last.copy_(returned)
        self.age += 1
        self.taken += 1
        # As by the clock that policies observe: the time at the end of the step.
        action = self.poses(self.tried_now, self._dt * self.age)
        most = self.SHAKEN if self.final else self.NOISE
        noise = torch.linspace(self.NOISE, most, len(action))[:, None]
        return (action + noise * torch.randn_like(action)).clamp(-1.0, 1.0)

    def _level_of(self, command: Tensor) -> Tensor:
        """Return the number of the nearest level of each command ``[*, 1]``, ``[*]``."""
        return (command - self.levels).abs().argmin(dim=-1)

    def _take_in(self, ended: Tensor) -> None:
        """Take in the returns of the jumps that have ended, bool ``[robots]``."""
        robots = ended.nonzero()[:, 0]
        level, slot = self.level[robots], self.slot[robots]
        # The last step's reward is not known; a fall is known by the time.
        result = self.last[robots] - self.FALL * (self.age[robots] < self._limit)
        final = slot >= 0
        place = level[final], slot[final]
        self.total.index_put_(place, result[final], accumulate=True)
        self.count.index_put_(place, torch.ones_like(result[final]), accumulate=True)
        begin = int(self.filled)
        new = (~final).nonzero()[:, 0][: len(self.result) - begin]
        into = slice(begin, begin + len(new))
        self.results[into], self.result[into] = self.tried_now[robots[new]], result[new]
        self.result_level[into] = level[new]
        self.filled += len(new)

    def _begin_jumps(self, begins: Tensor) -> None:
        """Choose the next jumps of robots, bool ``[robots]``."""
        level, count = self.level, len(begins)
        slot = torch.full_like(self.slot, -1)
        drawn = self.search.draw(level)
        # Fit jumps of another height help one that has found none.
        other = torch.randint(len(self.levels), (count,))
        known = self.elite_fitness[other, 0].isfinite() & (torch.rand(count) < self.INJECTED)
        drawn = torch.where(known[:, None], self.elite[other, 0], drawn)
        if int(self.taken) >= self._last_round:
            chosen = torch.randint(self.FINALISTS, (count,))
            known = self.elite_fitness[level, chosen].isfinite()
            slot = torch.where(known, chosen, slot)
            drawn = torch.where(known[:, None], self.elite[level, chosen], drawn)
        if int(self.taken) >= self._shown and self.tried:
            self.final.fill_(True)
            slot, drawn = torch.full_like(slot, -1), self.winners[level]
        self.slot.copy_(torch.where(begins, slot, self.slot))
        self.tried_now.copy_(torch.where(begins[:, None], drawn, self.tried_now))

    def _evolve(self) -> None:
        """Take the step of each level's distribution that its results since the last one ask for."""
        count = int(self.filled)
        for level in range(len(self.levels)):
            mine = (self.result_level[:count] == level).nonzero()[:, 0]
            if len(mine) >= self.FEWEST:
                self._keep_elite(level, self.results[mine], self.result[mine])
                beyond = (self.results[mine].abs() - 1.0).clamp(min=0.0).square().mean(dim=1)
                self.search.step(level, self.results[mine], self.result[mine] - self.OUTSIDE * beyond)
        self.filled.zero_()
        self.evolved.copy_(self.taken)

    def _keep_elite(self, level: int, jumps: Tensor, results: Tensor) -> None:
        """Remember the fittest jumps of a level, ``[n, D]``, by their results ``[n]``."""
        fitness = torch.cat([self.elite_fitness[level], results])
        best = fitness.argsort(descending=True)[: self.FINALISTS]
        self.elite[level] = torch.cat([self.elite[level], jumps])[best]
        self.elite_fitness[level] = fitness[best]

    @property
    def tried(self) -> bool:
        """Return whether jumps of each level were tried to their ends."""
        return bool(self.elite_fitness[:, 0].isfinite().all())

    @property
    def winners(self) -> Tensor:
        """Return the fittest jump of each level, ``[L, D]``."""
        means = torch.where(self.count > 0, self.total / self.count.clamp(min=1.0), -math.inf)
        best = torch.where((self.count > 0).any(dim=1), means.argmax(dim=1), 0)
        return self.elite[torch.arange(len(best)), best]

    def fittest_action(self, phase: Tensor, shown: Shown = NOTHING) -> Tensor:
        """Return the actions of the fittest jumps of the commanded heights after states of the given phases.

        Args:
            phase: Phase of the clock, ``[*]`` (periods).
            shown: What observations of these states show: the commanded height, ``[*, 1]`` (m).

        Returns:
            Actions, ``[*, A]``.
        """
        if (command := shown.command) is None:
            raise ValueError("Jumps need the commanded height.")
        shape, level = phase.shape, self._level_of(command).reshape(-1)
        time = phase.reshape(-1) / self._unit + self._dt
        return self.poses(self.winners[level], time).reshape(*shape, -1)

    @property
    def shows(self) -> bool:
        """Return whether robots try the winners, and go on to do so until the warm-up ends."""
        return bool(self.final)

    @property
    def followers(self) -> Tensor:
        """Return which robots try the winners then, bool ``[robots]``: all of them."""
        return torch.ones_like(self.level, dtype=torch.bool)
