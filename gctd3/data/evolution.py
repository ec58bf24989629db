"""Gaits that evolve during the warm-up: tried for a while, judged by the training's reward, and mutated."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from gctd3.data.motion_search import WAITS, MotionSearch
from gctd3.data.settings import LAST_ROUND
from gctd3.data.trials import NOTHING, Shown, Trials


class Evolution(MotionSearch):
    """Generate gaits that evolve.

    Each robot tries a gait for a while, remembers its best one, and most new gaits are mutations of what a few robots
    remember. Some trials are of a remembered gait, which then counts by the mean, and at the end of a round all robots
    try the fittest few. The fitness of a gait is the mean reward of the training while it is tried, less a penalty if
    the robot falls: what feet that slide or a body that sags cost a policy, they cost a gait. With a least speed a
    slower gait is less fit by :attr:`SLOW` for each m/s that its mean speed lacks.

    Args:
        num_robots: Number of robots.
        groups: Values of a gene of which each group of feet or joints has its own.
        trials: How gaits are tried.
        unit: Frequency of which a gait's ``frequency`` is a multiple (Hz).
        fixed: Genes that do not evolve, and their values.
        genes: Lowest and highest value of genes beside ``GENES``, and whether each group has its own.
    """

    frequency: Tensor
    fitness: Tensor
    cycles: Tensor
    start: Tensor
    lived: Tensor
    again: Tensor
    finalist: Tensor
    counted: Tensor
    chosen: Tensor
    walked: Tensor
    place: Tensor

    # Lowest and highest value of each gene, and whether each group has its own.
    GENES: ClassVar[Mapping[str, tuple[float, float, bool]]] = {}
    CYCLIC: tuple[str, ...] = ("phase",)
    REMEMBERED: ClassVar[tuple[str, ...]] = ("fitness",)  # what robots know of the gait that they remember
    MUTATION = 0.08  # standard deviation, of a gene's range
    RIVALS = 8  # robots of whom the fittest one is the parent
    FALL = 1.0  # by which a fall lowers the fitness: about what a brisk walk is worth (reward of a control step)
    SLOW = 2.0  # by which each m/s below the least speed lowers the fitness: twice what reward=walk pays for it
    AGAIN = 0.05  # share of trials in which a robot tries its remembered gait again; luck does not stay
    LAST_ROUND = LAST_ROUND
    SHOWN = 0.0
    ALIKE = False  # whether all trials of a last round count alike; else the last ones weigh most
    STARTS = 3  # episodes of each robot in that time: to start from standing is the hardest part
    NOISE = 0.1  # standard deviation of what is added to the actions

    def __init__(
        self,
        num_robots: int,
        groups: int,
        trials: Trials,
        unit: float = 1.0,
        fixed: Mapping[str, Tensor] | None = None,
        genes: Mapping[str, tuple[float, float, bool]] | None = None,
    ) -> None:
        super().__init__(num_robots, trials, unit)
        self.genes = {**(genes or {}), **self.GENES}
        self.groups, self._trials = groups, trials
        self._steps = max(round(trials.duration / trials.control_dt), 1)  # control steps of a trial
        self._showing = max(1, round(self.SHOWN * (trials.steps or 0) / trials.rounds / self.STARTS))
        self._fixed = dict(fixed or {})
        for name, values in self._draw(num_robots).items():
            self.register_buffer(name, values)
            self.register_buffer(f"best_{name}", values.clone())
        self._add_memory(num_robots)
        self.register_buffer("cycles", torch.zeros(num_robots))
        self.register_buffer("start", torch.zeros(num_robots))
        self.register_buffer("lived", torch.zeros(num_robots, dtype=torch.int64))
        self.register_buffer("again", torch.zeros(num_robots, dtype=torch.bool))
        self.register_buffer("finalist", torch.full((num_robots,), -1, dtype=torch.int64))
        # The one of them that is to count as the fittest, -1 for the one with the best mean.
        self.register_buffer("chosen", torch.tensor(-1))
        # Trials of each robot in a last round.
        self.register_buffer("counted", torch.zeros(num_robots))
        for name in self._remembered if trials.rounds > 1 else ():
            self.register_buffer(f"before_{name}", getattr(self, name).clone())
        if trials.least_speed is not None:
            self.register_buffer("walked", torch.zeros(num_robots))
            self.register_buffer("place", torch.zeros(num_robots))

    def _add_memory(self, count: int) -> None:
        """Register what robots know of the gaits that they remember, :attr:`REMEMBERED`."""
        self.register_buffer("fitness", torch.full((count,), -math.inf))

    @abstractmethod
    def act(self, genes: Mapping[str, Tensor], cycles: Tensor, shown: Shown = NOTHING) -> Tensor:
        """Return the actions of gaits, which are not clipped.

        Args:
            genes: Genes by name, ``[B]`` or ``[B, groups]``.
            cycles: Periods since the start of the episode, ``[B]``.
            shown: What observations of the robots show.

        Returns:
            Actions, ``[B, A]``.
        """

    def _draw(self, count: int) -> dict[str, Tensor]:
        drawn = {}
        for name, (low, high, paired) in self.genes.items():
            shape = (count, self.groups) if paired else (count,)
            drawn[name] = low + (high - low) * torch.rand(shape)
        return drawn | {name: value.expand(count, *value.shape).clone() for name, value in self._fixed.items()}

    def _children(self, count: int) -> dict[str, Tensor]:
        """Draw mutations of the fittest gaits among a few that robots remember, one for each robot."""
        rivals = torch.randint(count, (count, self.RIVALS))
        parent = rivals.gather(1, self.fitness[rivals].argmax(dim=1, keepdim=True))[:, 0]
        descends = (torch.rand(count) < self._trials.mutation_share) & self.fitness[parent].isfinite()
        children = self._draw(count)
        for name, (low, high, paired) in self.genes.items():
            if name in self._fixed:
                continue
            values = getattr(self, f"best_{name}")[parent]
            values = values + self.MUTATION * (high - low) * torch.randn_like(values)
            values = values % 1.0 if name in self.CYCLIC else values.clamp(low, high)
            children[name] = torch.where(descends[:, None] if paired else descends, values, children[name])
        return children

    def _end(self, ended: Tensor, begins: Tensor) -> None:
        """Remember the gaits of the trials that have ended if they are fitter, and begin new ones."""
        complete = self.age >= self._steps
        fell = begins & (self.lived < self._limit)
        if self._trials.from_standing:
            # The episode ended because the trial was over.
            fell &= ~complete
        # A trial that the time limit cuts short says nothing.
        tried = ended & (self.age > 0) & (fell | complete)
        # What falls earns nothing for the rest of its trial; one that waits for its episode to end is longer.
        result = (self.last - self.start) / self.age.clamp(min=self._steps) - self.FALL * fell
        if self._trials.least_speed is not None:
            # A robot that falls has not walked for the rest of the trial.
            speed = self.walked / (self.age.clamp(min=self._steps) * self._dt)
            result = result - self.SLOW * (self._trials.least_speed - speed).clamp(min=0.0)
        fitter = self._judge(tried, result)
        children = self._children(len(ended))
        share = 1.0 if self.final else self.AGAIN
        repeats = (torch.rand(len(ended)) < share) & self.fitness.isfinite()
        self.again.copy_(torch.where(ended, repeats, self.again))
        for name, (_, _, paired) in self.genes.items():
            best, now = getattr(self, f"best_{name}"), getattr(self, name)
            best.copy_(torch.where(fitter[:, None] if paired else fitter, now, best))
            next_one = torch.where(repeats[:, None] if paired else repeats, best, children[name])
            now.copy_(torch.where(ended[:, None] if paired else ended, next_one, now))

    def _judge(self, tried: Tensor, result: Tensor) -> Tensor:
        """Take in the results of trials, and return which robots found a gait fitter than the one that they remember.

        Args:
            tried: Robots whose trial has ended, bool ``[robots]``.
            result: Mean reward of their trial, less penalties, ``[robots]``.
        """
        # Of a gait that was tried again the mean counts, in which the last trials weigh most.
        again = tried & self.again
        self.fitness.copy_(torch.where(again, torch.lerp(self.fitness, result, self._share(again)), self.fitness))
        fitter = tried & ~again & (result > self.fitness)
        self.fitness.copy_(torch.where(fitter, result, self.fitness))
        return fitter

    def _share(self, again: Tensor) -> Tensor:
        """Count trials of gaits that were tried again, and return the weight of each in the mean, ``[robots]``."""
        if not (self.final and self.ALIKE):
            return torch.full_like(self.counted, 0.5)
        self.counted += again
        return 1.0 / self.counted.clamp(min=1.0)

    def _begin_last_round(self) -> None:
        """Let the robots remember the fittest few gaits, in turn, and nothing else."""
        self.final.fill_(True)
        self.chosen.fill_(-1)
        self.counted.zero_()
        for name in self._remembered if self.rounds > 1 else ():
            getattr(self, f"before_{name}").copy_(getattr(self, name))
        first = self.fitness.argsort(descending=True)[: self.FINALISTS]
        first = first[self.fitness[first].isfinite()]
        chosen = first[torch.arange(len(self.fitness)) % len(first)]
        self.finalist.copy_(chosen)
        for name in self._remembered:
            values = getattr(self, name)
            values.copy_(values[chosen].clone())

    @property
    def _remembered(self) -> list[str]:
        """Return the names of what robots know of the gaits that they remember."""
        return [*self.REMEMBERED, *(f"best_{name}" for name in self.genes)]

    def go_on(self) -> None:
        """Begin another round, in which robots remember what they did; how fit finalists are is known better now."""
        known = self.finalists
        means = {
            name: torch.stack([getattr(self, name)[self.finalist == one].mean(dim=0) for one in known])
            for name in self.REMEMBERED
        }
        for name in self._remembered:
            getattr(self, name).copy_(getattr(self, f"before_{name}"))
        for name, values in means.items():
            getattr(self, name)[known] = values
        self.finalist.fill_(-1)
        super().go_on()

    @property
    def finalists(self) -> list[int]:
        """Return the gaits of the last round, the fittest first, each by the number of a robot."""
        if not self.final:
            return []
        return list(dict.fromkeys(self.finalist[self._means.argsort(descending=True)].tolist()))

    def choose(self, finalist: int | None) -> None:
        """Let a gait of the last round count as the fittest one; ``None`` for the one with the best mean."""
        self.chosen.fill_(-1 if finalist is None else finalist)

    def _let_all_follow(self) -> None:
        """Let all robots remember the fittest gait, and nothing else."""
        best = self._best
        self.fitness.fill_(float(self.fitness[self.followers].mean()))
        self.finalist.fill_(int(self.finalist[best]))
        for name in self.genes:
            values = getattr(self, f"best_{name}")
            values.copy_(values[best].expand_as(values).clone())

    def forward(
        self,
        is_init: Tensor,
        returned: Tensor,
        position: Tensor | None = None,
        shown: Shown = NOTHING,
    ) -> Tensor:
        """Return the actions ``[robots, A]`` of the next step; see :meth:`.MotionSearch.forward`."""
        if self._trials.least_speed is not None and position is not None:
            # Of an episode that has begun anew the last step is not known.
            self.walked += torch.where(is_init, 0.0, position - self.place)
            self.place.copy_(position)
        over = torch.zeros_like(is_init) if self._trials.from_standing else self.age >= self._steps
        ended = is_init | over | (self.age == -1)
        begins, decides = self.begins, self.decides
        if begins or decides:
            if begins:
                self._begin_last_round()
            else:
                self._let_all_follow()
            # Trials that have not ended are given up.
            ended = torch.ones_like(ended)
            self.age.fill_(0)
        if ended.any():
            self.last.copy_(torch.where(is_init, self.last, returned))
            self._end(ended, is_init)
            self.start.copy_(torch.where(ended, returned, self.start))
            self.age.copy_(torch.where(ended, 0, self.age))
            if self._trials.least_speed is not None:
                self.walked.copy_(torch.where(ended, 0.0, self.walked))
            self.cycles.copy_(torch.where(is_init, 0.0, self.cycles))
            self.lived.copy_(torch.where(is_init, 0, self.lived))
        self.last.copy_(returned)
        self.lived += 1
        self.age += self.age >= 0
        self.taken += 1
        self.cycles += self._dt * self._unit * self.frequency
        action = self.act({name: getattr(self, name) for name in self.genes}, self.cycles, shown)
        return self._shaken(action).clamp(-1.0, 1.0)

    def _shaken(self, action: Tensor) -> Tensor:
        """Return actions ``[robots, A]`` with noise."""
        return action + self.NOISE * torch.randn_like(action)

    @property
    def _best(self) -> int:
        """Return a robot that remembers the fittest gait."""
        if not self.final:
            return int(self.fitness.argmax())
        if int(self.chosen) >= 0:
            return int((self.finalist == self.chosen).nonzero()[0])
        return int(self._means.argmax())

    @property
    def _means(self) -> Tensor:
        """Return for each robot the mean fitness of all that try the same finalist."""
        tried_by = torch.bincount(self.finalist, minlength=len(self.finalist))
        sums = torch.zeros_like(self.fitness).index_add_(0, self.finalist, self.fitness)
        return (sums / tried_by)[self.finalist]

    @property
    def begins(self) -> bool:
        """Return whether in the next step the last round begins."""
        return not self.final and int(self.taken) >= self._last_round and self.tried

    @property
    def decides(self) -> bool:
        """Return whether in the next step all robots begin to try the winner."""
        return bool(self.final) and int(self.taken) >= self._shown and not bool(self.followers.all())

    @property
    def anew(self) -> Tensor | None:
        """Return which robots had best begin a new episode before the next step: of the last gaits starts count too."""
        since = int(self.taken) - self._shown
        showing = self.SHOWN and self.shows and since > 0 and since % self._showing == 0
        if self.begins or self.decides or showing:
            return torch.ones_like(self.again)
        asks = self.age == WAITS
        if self._trials.from_standing:
            asks |= self.age >= self._steps
        return asks if bool(asks.any()) else None

    @property
    def shows(self) -> bool:
        """Return whether robots that try the fittest gait are known, and go on to do so until the warm-up ends."""
        return bool(self.final) and (not self.SHOWN or bool(self.followers.all()))

    @property
    def followers(self) -> Tensor:
        """Return which robots try the fittest gait in the last round, bool ``[robots]``."""
        return self.finalist == self.finalist[self._best]

    def _fittest(self, count: int) -> dict[str, Tensor]:
        """Return the genes of the fittest gait, ``count`` times."""
        best = self._best
        genes = {name: getattr(self, f"best_{name}")[best] for name in self.genes}
        return {name: value.expand(count, *value.shape) for name, value in genes.items()}

    @property
    def tried(self) -> bool:
        """Return whether a gait was tried to its end."""
        return bool(self.fitness.isfinite().any())

    def fittest_action(self, phase: Tensor, shown: Shown = NOTHING) -> Tensor:
        """Return the actions ``[*, A]`` of the fittest gait after states of phases ``[*]`` (periods of its clock)."""
        genes = self._fittest(len(phase))
        cycles = phase + self._dt * self._unit * genes["frequency"]
        return self.act(genes, cycles, shown).clamp(-1.0, 1.0)

    def fittest_actions(self, steps: int) -> Tensor:
        """Return the actions of the fittest gait in the first ``steps`` control steps of an episode, ``[steps, A]``."""
        genes = self._fittest(steps)
        cycles = torch.arange(1, steps + 1) * self._dt * self._unit * genes["frequency"]
        return self.act(genes, cycles).clamp(-1.0, 1.0)
