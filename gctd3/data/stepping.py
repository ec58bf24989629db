"""Gaits whose feet step: they evolve during the warm-up, and training starts from their transitions."""

from __future__ import annotations

import math

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from gctd3.data.reflexes import GENES as REFLEXES
from gctd3.data.reflexes import NONE_AT_FIRST, reflexes
from gctd3.robots.foot_paths import arcs, joint_paths, sides
from gctd3.robots.gait_pattern import GRAVITY, GaitPattern
from gctd3.robots.robot import Robot
from gctd3.tasks.posture import SENSES, Posture


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

    The gaits are open-loop ones unless ``posture`` is given: then feet answer to the body's posture
    (:func:`.reflexes`), with gains that evolve too, and legs with joints enough keep their soles level.

    Args:
        robot: The robot.
        num_robots: Number of robots.
        trial: Time for which a gait is tried (s).
        control_dt: Control period (s).
        mutation_share: Share of new gaits that descend from others.
        gait: Frequency and phases of the feet of all gaits; they evolve if ``None``.
        steps: Control steps of the warm-up; ``None`` for one without an end.
        posture: What shows the body's posture in observations; ``None`` for open-loop gaits.

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
    age: Tensor
    again: Tensor
    taken: Tensor
    final: Tensor
    finalist: Tensor

    # Lowest and highest value of each gene, and whether each pair of feet has its own; gaits with reflexes have more.
    GENES: dict[str, tuple[float, float, bool]] = {  # noqa: RUF012 - a constant
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
        posture: Posture | None = None,
    ) -> None:
        super().__init__()
        self._length, self.posture = robot.leg_length, posture
        self.genes = self.GENES if posture is None else self.GENES | REFLEXES
        self._dt, self._share = control_dt, mutation_share
        self._steps = max(round(trial / control_dt), 1)
        self._last_round = math.inf if steps is None else (1.0 - self.LAST_ROUND) * steps
        self._pendulum = math.sqrt(GRAVITY / self._length) / (2 * math.pi)
        group, lag = _groups(robot)
        self.register_buffer("pair_of", group, persistent=False)
        self.register_buffer("lagging", lag, persistent=False)
        paths = joint_paths(robot, self.DAMPING * self._length, soles=posture is not None)
        self.register_buffer("joints", torch.from_numpy(paths if posture else paths[:, :3]).float(), persistent=False)
        self.register_buffer("arc", torch.from_numpy(arcs(robot, paths)).float(), persistent=False)
        self.register_buffer("left", torch.from_numpy(sides(robot)).float(), persistent=False)
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

    def _end(self, ended: Tensor, fell: Tensor) -> None:
        """Remember the gaits of the trials that have ended if they are fitter, and begin new ones."""
        tried = ended & (self.age > 0)
        fitness = (self.last - self.start) / self._steps - self.FALL * fell
        # Of a gait that was tried again the mean counts, in which the last trials weigh most.
        again = tried & self.again
        self.fitness.copy_(torch.where(again, 0.5 * (self.fitness + fitness), self.fitness))
        fitter = tried & ~again & (fitness > self.fitness)
        self.fitness.copy_(torch.where(fitter, fitness, self.fitness))
        children = self._children(len(ended))
        share = 1.0 if self.final else self.AGAIN
        repeats = (torch.rand(len(ended)) < share) & self.fitness.isfinite()
        self.again.copy_(torch.where(ended, repeats, self.again))
        for name, (_, _, paired) in self.genes.items():
            best, now = getattr(self, f"best_{name}"), getattr(self, name)
            best.copy_(torch.where(fitter[:, None] if paired else fitter, now, best))
            next_one = torch.where(repeats[:, None] if paired else repeats, best, children[name])
            now.copy_(torch.where(ended[:, None] if paired else ended, next_one, now))

    def _begin_last_round(self) -> None:
        """Let the robots remember the fittest few gaits, in turn, and nothing else."""
        self.final.fill_(True)
        first = self.fitness.argsort(descending=True)[: self.FINALISTS]
        first = first[self.fitness[first].isfinite()]
        chosen = first[torch.arange(len(self.fitness)) % len(first)]
        self.finalist.copy_(chosen)
        for name in ("fitness", *(f"best_{name}" for name in self.genes)):
            values = getattr(self, name)
            values.copy_(values[chosen].clone())

    def forward(self, is_init: Tensor, returned: Tensor, nodes: Tensor | None = None) -> Tensor:
        """Return the actions ``[robots, A]`` of the next step.

        Args:
            is_init: Robots whose episode begins, bool ``[robots]``.
            returned: Sum of the episode's rewards so far, ``[robots]``.
            nodes: Observations of the nodes, ``[robots, N, F * H]``, which gaits with reflexes need.
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
        self.last.copy_(returned)
        self.age += 1
        self.taken += 1
        self.cycles += self._dt * self._pendulum * self.frequency
        action = self._act({name: getattr(self, name) for name in self.genes}, self.cycles, nodes)
        return (action + self.NOISE * torch.randn_like(action)).clamp(-1.0, 1.0)

    def _act(self, genes: dict[str, Tensor], cycles: Tensor, nodes: Tensor | None = None) -> Tensor:
        turn = 2 * math.pi
        phase = cycles[:, None] + genes["phase"][:, self.pair_of] + self.lagging
        lead, lag, duty, softness = (genes[name][:, None] for name in ("lead", "lag", "duty", "softness"))
        way, lift = foot_way(phase + lead, duty), foot_height(phase + lag, softness)
        forward = genes["shift"][:, self.pair_of] + genes["stride"][:, None] * way
        up = genes["crouch"][:, None] + genes["lift"][:, None] * lift
        side = (genes["sway"] * torch.sin(turn * (cycles + genes["sway_phase"])))[:, None].expand_as(up)
        if self.posture is None:
            up = up - self.arc * forward.square()
            moved = self._length * torch.stack([forward, side, up], dim=-1)
            return torch.einsum("nfd,fda->na", moved, self.joints)
        answer = reflexes(genes, self._deviation(genes, nodes), lift, self.left)
        forward, side = forward + answer[..., 0], side + answer[..., 1]
        up = up + answer[..., 2] - self.arc * forward.square()
        moved = self._length * torch.stack([forward, side, up], dim=-1)
        return torch.einsum("nfd,fda->na", torch.cat([moved, answer[..., 3:]], dim=-1), self.joints)

    def _deviation(self, genes: dict[str, Tensor], nodes: Tensor | None) -> Tensor:
        """Return the posture ``[robots, 6]`` less the steady gait's: upright, at the speed at which feet push back."""
        if nodes is None or self.posture is None:
            raise ValueError("a gait with reflexes needs observations of the nodes")
        posture: Tensor = self.posture(nodes)
        # Half of the way in a stance, leg lengths, at a pendulum's frequency.
        speed = genes["stride"] * genes["frequency"] / (math.pi * genes["duty"])
        steady = torch.zeros_like(posture)
        steady[:, SENSES.index("speed")] = speed * self.posture.observed[SENSES.index("speed")]
        return posture - steady

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

    def fittest_action(self, phase: Tensor, nodes: Tensor | None = None) -> Tensor:
        """Return the actions of the fittest gait after states of the given phases; all gaits keep to one frequency.

        Args:
            phase: Phase of the gait, ``[B]`` (periods).
            nodes: Observations of the nodes, ``[B, N, F * H]``, which gaits with reflexes need.

        Returns:
            Actions, ``[B, A]``.
        """
        genes = self._fittest(len(phase))
        cycles = phase + self._dt * self._pendulum * genes["frequency"]
        return self._act(genes, cycles, nodes).clamp(-1.0, 1.0)

    def phase_after(self, steps: int) -> Tensor:
        """Return the phase of the fittest gait so many control steps after the start of an episode, ``[1]``."""
        return steps * self._dt * self._pendulum * self._fittest(1)["frequency"]

    def fittest(self) -> FittestGait | None:
        """Return the fittest gait as a policy, if one was tried."""
        return FittestGait(self) if self.tried else None


class FittestGait(TensorDictModuleBase):
    """Act by the fittest gait of a warm-up, from the start of an episode that all robots begin.

    It reads ``"nodes"`` where the gait has reflexes, and nothing else.

    Args:
        gaits: The gaits of the warm-up.
    """

    def __init__(self, gaits: Stepping) -> None:
        super().__init__()
        self.in_keys, self.out_keys = [] if gaits.posture is None else ["nodes"], ["action"]
        self.gaits, self.taken = gaits, 0

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the next action of every robot."""
        phase = self.gaits.phase_after(self.taken).expand(tensordict.numel())
        self.taken += 1
        nodes = tensordict.get("nodes").flatten(0, -3) if self.in_keys else None
        action = self.gaits.fittest_action(phase, nodes)
        return tensordict.set("action", action.reshape(*tensordict.batch_size, -1))


def foot_way(phase: Tensor, duty: Tensor) -> Tensor:
    """Return how far a foot is forwards in a stride, from -1 to 1.

    On the ground it moves backwards at a constant speed, as the ground does below a body of constant speed. In the air
    it moves forwards with the least jerk (Flash & Hogan 1985) beside that speed, so that it neither jerks nor slides
    when it lifts off and touches down.

    Args:
        phase: Phase of the foot, ``[*]`` (periods); the middle of its swing is at a quarter.
        duty: Share of a period in which it goes backwards, ``[*]``.

    Returns:
        Places in halves of its way, ``[*]``, which it overshoots by up to 0.2 in the air.
    """
    swing = ((phase + 0.25) % 1.0 - 0.5) / (1.0 - duty) + 0.5
    stance = ((phase - 0.25) % 1.0 - 0.5) / duty + 0.5
    back = 2.0 * (1.0 - duty) / duty  # of the ground, while the foot swings
    air = (2.0 + back) * swing**3 * ((6.0 * swing - 15.0) * swing + 10.0) - back * swing - 1.0
    return torch.where((swing > 0.0) & (swing < 1.0), air, 1.0 - 2.0 * stance)


def foot_height(phase: Tensor, softness: Tensor) -> Tensor:
    """Return how high a foot is in a stride, from 0 to 1: a power of a sine in the first half of its period.

    That is longer than it goes forwards, so that a leg that its load has bent is unloaded before, and loaded after.

    Args:
        phase: Phase of the foot, ``[*]`` (periods).
        softness: The power, ``[*]``; it touches down at a speed of 0 if above 1.
    """
    return torch.sin(2 * math.pi * phase).clamp(min=0.0) ** softness


def _groups(robot: Robot) -> tuple[Tensor, Tensor]:
    """Return the number of each foot's pair, and the phase by which the second foot of a pair lags, each ``[feet]``."""
    group, lag, count = [-1] * len(robot.feet), [0.0] * len(robot.feet), 0
    for foot, other in enumerate(robot.mirror_feet):
        if group[foot] < 0:
            group[foot] = group[other] = count
            lag[other] = 0.5 if other != foot else 0.0
            count += 1
    return torch.tensor(group), torch.tensor(lag)
