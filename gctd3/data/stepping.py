"""Gaits whose feet step: they evolve during the warm-up, and training starts from their transitions."""

from __future__ import annotations

import math
from typing import ClassVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from gctd3.data.foot_paths import foot_arcs, foot_groups, foot_height, foot_places, foot_way, joint_paths
from gctd3.data.reflexes import GENES as REFLEXES
from gctd3.data.reflexes import NONE_AT_FIRST, reflexes
from gctd3.robots.gait_pattern import GRAVITY, GaitPattern
from gctd3.robots.robot import Robot
from gctd3.tasks.posture import SENSES


class Stepping(torch.nn.Module):
    """Generate gaits in which every foot moves to and fro and is lifted on its way forwards.

    The path of a foot about its place in the standing pose becomes joint angles by the pseudo-inverse of its leg's
    Jacobian, less the arc that it would go along. On the ground a foot moves as the ground does below a body of
    constant speed, and it touches down and lifts off at that speed, so that it need not slide. Left and right feet
    step half a period apart; the phases of the pairs, frequency, length and height of the steps, a shift of each pair
    of feet, a crouch and a sway are drawn, and evolve: each robot tries a gait for a while, remembers its best one,
    and most new gaits are mutations of what a few robots remember. Some trials are of a remembered gait, which then
    counts by the mean, and in the last round all robots try the fittest few. The fitness of a gait is the mean reward
    of the training while it is tried, less a penalty if the robot falls: what feet that slide or a body that sags cost
    a policy, they cost a gait. Lengths are in leg lengths and frequencies in those of a pendulum as long as the leg, so
    that the same numbers serve robots of all sizes.

    The gaits are open-loop ones unless they have reflexes: then feet answer to the body's posture (:func:`.reflexes`),
    with gains that evolve too, and legs with joints enough keep their soles level.

    Args:
        robot: The robot.
        num_robots: Number of robots.
        trial: Time for which a gait is tried (s).
        control_dt: Control period (s).
        mutation_share: Share of new gaits that descend from others.
        gait: Frequency and phases of the feet of all gaits; they evolve if ``None``.
        steps: Control steps of the warm-up; ``None`` for one without an end.
        limit: Control steps after which an episode ends though the robot has not fallen; ``None`` for no such limit.
        balances: Whether gaits have reflexes.

    Raises:
        ConfigError: If no foot has a driven joint of its own.
    """

    frequency: Tensor
    pair_of: Tensor
    lagging: Tensor
    left: Tensor
    joints: Tensor
    arc: Tensor
    fitness: Tensor
    cycles: Tensor
    start: Tensor
    last: Tensor
    lived: Tensor
    age: Tensor
    again: Tensor
    taken: Tensor
    final: Tensor
    finalist: Tensor

    # Lowest and highest value of each gene, and whether each pair of feet has its own; reflexes have more.
    GENES: ClassVar[dict[str, tuple[float, float, bool]]] = {
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
    REMEMBERED: ClassVar[tuple[str, ...]] = ("fitness",)  # what robots know of the gait that they remember
    MUTATION = 0.08  # standard deviation, of a gene's range
    RIVALS = 8  # robots of whom the fittest one is the parent
    FALL = 1.0  # by which a fall lowers the fitness: about what a brisk walk is worth (reward of a control step)
    AGAIN = 0.05  # share of trials in which a robot tries its remembered gait again; luck does not stay
    LAST_ROUND = 0.3  # share of the warm-up, at its end, in which all robots try the fittest few gaits
    FINALISTS = 8  # of these gaits; the fittest one by the mean over its robots wins
    NOISE = 0.1  # standard deviation of what is added to the actions
    DAMPING = 0.05  # of the pseudo-inverse, leg lengths

    def __init__(
        self,
        robot: Robot,
        num_robots: int,
        trial: float,
        control_dt: float,
        mutation_share: float = 0.8,
        gait: GaitPattern | None = None,
        steps: int | None = None,
        limit: int | None = None,
        balances: bool = False,
    ) -> None:
        super().__init__()
        self.balances = balances
        self.genes = self.GENES | (REFLEXES if balances else {})
        self._limit = math.inf if limit is None else limit
        self._length = robot.leg_length
        self._dt, self._share = control_dt, mutation_share
        self._steps = max(round(trial / control_dt), 1)
        self._last_round = math.inf if steps is None else (1.0 - self.LAST_ROUND) * steps
        self._pendulum = math.sqrt(GRAVITY / self._length) / (2 * math.pi)
        group, lag = foot_groups(robot)
        self.register_buffer("pair_of", group, persistent=False)
        self.register_buffer("lagging", lag, persistent=False)
        self.register_buffer("joints", joint_paths(robot, self.DAMPING * self._length, balances), persistent=False)
        self.register_buffer("arc", foot_arcs(robot, self.joints), persistent=False)
        self.register_buffer("left", foot_places(robot)[:, 1].sign(), persistent=False)
        self.groups = int(group.max()) + 1
        self._fixed: dict[str, Tensor] = {}
        if gait is not None:
            # Of a robot whose feet are no mirror images, each foot has the phase that the gait gives it.
            phases = torch.from_numpy(gait.phases).float()
            firsts = phases[[int((group == pair).nonzero()[0]) for pair in range(self.groups)]]
            self.lagging = phases - firsts[group]
            self._fixed = {"frequency": torch.tensor(gait.frequency / self._pendulum), "phase": firsts}
        for name, values in self._draw(num_robots).items():
            self.register_buffer(name, values)
            self.register_buffer(f"best_{name}", values.clone())
        self.register_buffer("fitness", torch.full((num_robots,), -math.inf))
        self.register_buffer("cycles", torch.zeros(num_robots))
        self.register_buffer("start", torch.zeros(num_robots))
        self.register_buffer("last", torch.zeros(num_robots))
        self.register_buffer("lived", torch.zeros(num_robots, dtype=torch.int64))
        self.register_buffer("taken", torch.zeros((), dtype=torch.int64))
        self.register_buffer("again", torch.zeros(num_robots, dtype=torch.bool))
        self.register_buffer("final", torch.zeros((), dtype=torch.bool))
        self.register_buffer("finalist", torch.full((num_robots,), -1, dtype=torch.int64))
        # No trial has begun.
        self.register_buffer("age", torch.full((num_robots,), -1, dtype=torch.int64))

    def _draw(self, count: int) -> dict[str, Tensor]:
        drawn = {}
        for name, (low, high, paired) in self.genes.items():
            shape = (count, self.groups) if paired else (count,)
            drawn[name] = low + (high - low) * torch.rand(shape)
            if name in REFLEXES:
                drawn[name] *= torch.rand(shape) >= NONE_AT_FIRST
        return drawn | {name: value.expand(count, *value.shape).clone() for name, value in self._fixed.items()}

    def _children(self, count: int) -> dict[str, Tensor]:
        """Draw mutations of the fittest gaits among a few that robots remember, one for each robot."""
        rivals = torch.randint(count, (count, self.RIVALS))
        parent = rivals.gather(1, self.fitness[rivals].argmax(dim=1, keepdim=True))[:, 0]
        descends = (torch.rand(count) < self._share) & self.fitness[parent].isfinite()
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
        fell = begins & (self.lived < self._limit)
        # A trial that the time limit cuts short says nothing.
        tried = ended & (self.age > 0) & (fell | (self.age >= self._steps))
        fitter = self._judge(tried, (self.last - self.start) / self._steps - self.FALL * fell)
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
            result: Mean reward of their trial, less the penalty of a fall, ``[robots]``.
        """
        # Of a gait that was tried again the mean counts, in which the last trials weigh most.
        again = tried & self.again
        self.fitness.copy_(torch.where(again, 0.5 * (self.fitness + result), self.fitness))
        fitter = tried & ~again & (result > self.fitness)
        self.fitness.copy_(torch.where(fitter, result, self.fitness))
        return fitter

    def _begin_last_round(self) -> None:
        """Let the robots remember the fittest few gaits, in turn, and nothing else."""
        self.final.fill_(True)
        first = self.fitness.argsort(descending=True)[: self.FINALISTS]
        first = first[self.fitness[first].isfinite()]
        chosen = first[torch.arange(len(self.fitness)) % len(first)]
        self.finalist.copy_(chosen)
        for name in (*self.REMEMBERED, *(f"best_{name}" for name in self.genes)):
            values = getattr(self, name)
            values.copy_(values[chosen].clone())

    def forward(
        self, is_init: Tensor, returned: Tensor, command: Tensor | None = None, posture: Tensor | None = None
    ) -> Tensor:
        """Return the actions ``[robots, A]`` of the next step.

        Args:
            is_init: Robots whose episode begins, bool ``[robots]``.
            returned: Sum of the episode's rewards so far, ``[robots]``.
            command: Commanded velocity, ``[robots, 3]`` (m/s, m/s, rad/s); ``None`` for gaits that follow none.
            posture: The body's posture, ``[robots, 6]`` (:class:`.Posture`), which gaits with reflexes need.
        """
        ended = is_init | (self.age >= self._steps) | (self.age < 0)
        if not self.final and int(self.taken) >= self._last_round and self.tried:
            self._begin_last_round()
            # Trials that have not ended are given up.
            ended = torch.ones_like(ended)
            self.age.fill_(0)
        if ended.any():
            self.last.copy_(torch.where(is_init, self.last, returned))
            self._end(ended, is_init)
            self.start.copy_(torch.where(ended, returned, self.start))
            self.age.copy_(torch.where(ended, 0, self.age))
            self.cycles.copy_(torch.where(is_init, 0.0, self.cycles))
            self.lived.copy_(torch.where(is_init, 0, self.lived))
        self.last.copy_(returned)
        self.lived += 1
        self.age += 1
        self.taken += 1
        self.cycles += self._dt * self._pendulum * self.frequency
        action = self._act({name: getattr(self, name) for name in self.genes}, self.cycles, command, posture)
        return (action + self.NOISE * torch.randn_like(action)).clamp(-1.0, 1.0)

    def _act(
        self,
        genes: dict[str, Tensor],
        cycles: Tensor,
        command: Tensor | None = None,
        posture: Tensor | None = None,
    ) -> Tensor:
        phase = cycles[:, None] + genes["phase"][:, self.pair_of] + self.lagging
        lead, lag, duty, softness = (genes[name][:, None] for name in ("lead", "lag", "duty", "softness"))
        way, lift = foot_way(phase + lead, duty), foot_height(phase + lag, softness)
        sway = genes["sway"] * torch.sin(2 * math.pi * (cycles + genes["sway_phase"]))
        half, amount = self._steps_of(genes, command)
        forward = genes["shift"][:, self.pair_of] + half[..., 0] * way
        side = half[..., 1] * way + amount * sway[:, None]
        up = genes["crouch"][:, None] + amount * genes["lift"][:, None] * lift
        if not self.balances:
            moved = torch.stack([forward, side, up - self.arc * forward.square()], dim=-1)
            return torch.einsum("nfd,fda->na", self._length * moved, self.joints)
        if posture is None:
            raise ValueError("Gaits with reflexes need the body's posture.")
        answer = reflexes(genes, posture - self._steady(genes, half, posture), lift, self.left)
        forward, side, up = (path + answer[..., k] for k, path in enumerate((forward, side, up)))
        moved = torch.stack([forward, side, up - self.arc * forward.square()], dim=-1)
        return torch.einsum("nfd,fda->na", torch.cat([self._length * moved, answer[..., 3:]], dim=-1), self.joints)

    @staticmethod
    def _steady(genes: dict[str, Tensor], half: Tensor, posture: Tensor) -> Tensor:
        """Return the posture of the steady gait: upright, at the velocity at which feet push the ground back."""
        # Half of a foot's way in a stance, in units of a pendulum as long as the leg.
        velocity = half.mean(dim=1) * (genes["frequency"] / (math.pi * genes["duty"]))[:, None]
        steady = torch.zeros_like(posture)
        steady[:, SENSES.index("speed")], steady[:, SENSES.index("drift")] = velocity.unbind(-1)
        return steady

    def _steps_of(self, genes: dict[str, Tensor], command: Tensor | None) -> tuple[Tensor, Tensor]:
        """Return the steps of gaits: half of each foot's way, and how much of lift and sway there is.

        Returns:
            Half of the way forward and to the left, broadcast to ``[n, feet, 2]`` (leg lengths), and a share of
            broadcast ``[n, feet]``.
        """
        stride = genes["stride"]
        return torch.stack([stride, torch.zeros_like(stride)], dim=-1)[:, None], torch.ones(1, 1)

    def _fittest(self, count: int) -> dict[str, Tensor]:
        """Return the genes of the fittest gait, ``count`` times."""
        best = int(self.fitness.argmax())
        if self.final:
            means = [self.fitness[self.finalist == one].mean() for one in self.finalist]
            best = int(torch.stack(means).argmax())
        genes = {name: getattr(self, f"best_{name}")[best] for name in self.genes}
        return {name: value.expand(count, *value.shape) for name, value in genes.items()}

    @property
    def tried(self) -> bool:
        """Return whether a gait was tried to its end."""
        return bool(self.fitness.isfinite().any())

    def fittest_action(self, phase: Tensor, command: Tensor | None = None, posture: Tensor | None = None) -> Tensor:
        """Return the actions of the fittest gait after states of the given phases; all gaits keep to one frequency.

        Args:
            phase: Phase of the gait, ``[*]`` (periods).
            command: Commanded velocity, ``[*, 3]`` (m/s, m/s, rad/s); ``None`` for a gait that follows none.
            posture: The body's posture, ``[*, 6]``, which a gait with reflexes needs.

        Returns:
            Actions, ``[*, A]``.
        """
        genes = self._fittest(len(phase))
        cycles = phase + self._dt * self._pendulum * genes["frequency"]
        return self._act(genes, cycles, command, posture).clamp(-1.0, 1.0)

    def fittest(self, steps: int) -> OpenLoop | None:
        """Return the fittest gait as a policy for episodes of up to ``steps`` control steps, if one was tried."""
        if not self.tried:
            return None
        genes = self._fittest(steps)
        cycles = torch.arange(1, steps + 1) * self._dt * self._pendulum * genes["frequency"]
        return OpenLoop(self._act(genes, cycles).clamp(-1.0, 1.0))


class OpenLoop(TensorDictModuleBase):
    """Act in all robots by a list of actions, whatever they observe, from the start of an episode that all begin.

    Args:
        actions: Action of each control step, shape ``[steps, A]``; the last one is repeated.
    """

    def __init__(self, actions: Tensor) -> None:
        super().__init__()
        self.in_keys, self.out_keys = list[str](), ["action"]
        self.actions, self.taken = actions, 0

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the next action of the list for every robot."""
        action = self.actions[min(self.taken, len(self.actions) - 1)]
        self.taken += 1
        return tensordict.set("action", action.expand(*tensordict.batch_size, -1).clone())
