"""Open-loop gaits whose feet step: they evolve during the warm-up, and training starts from their transitions."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from gctd3.errors import ConfigError
from gctd3.robots.gait_pattern import GRAVITY, GaitPattern
from gctd3.robots.robot import Robot


class Stepping(torch.nn.Module):
    """Generate open-loop gaits in which every foot moves to and fro and is lifted on its way forwards.

    The path of a foot about its place in the standing pose becomes joint angles by the pseudo-inverse of its leg's
    Jacobian. Left and right feet step half a period apart; the phases of the pairs, frequency, length and height of
    the steps, a shift of each pair of feet, a crouch and a sway are drawn, and evolve: each robot tries a gait for a
    while, remembers its best one, and most new gaits are mutations of what a few robots remember. Some trials, and all
    in the last round, are of a remembered gait, which then counts by the mean. The fitness of a gait
    is the distance that it covers while it is tried, as far as a brisk walk would get, less a penalty if the robot
    falls. Lengths are in leg lengths and frequencies in those of a pendulum as long as the leg, so that the same
    numbers serve robots of all sizes.

    Args:
        robot: The robot.
        num_robots: Number of robots.
        trial: Time for which a gait is tried (s).
        control_dt: Control period (s).
        mutation_share: Share of new gaits that descend from others.
        gait: Frequency and phases of the feet of all gaits; they evolve if ``None``.
        steps: Control steps of the warm-up; ``None`` for one without an end.

    Raises:
        ConfigError: If no foot has a driven joint of its own.
    """

    frequency: Tensor
    pair_of: Tensor
    lagging: Tensor
    joints: Tensor
    fitness: Tensor
    cycles: Tensor
    start: Tensor
    last: Tensor
    age: Tensor
    again: Tensor
    taken: Tensor

    # Lowest and highest value of each gene, and whether each pair of feet has its own.
    GENES: dict[str, tuple[float, float, bool]] = {  # noqa: RUF012 - a constant
        "frequency": (1.0, 3.2, False),  # of a pendulum as long as the leg
        "stride": (0.05, 0.45, False),  # half of a foot's way to and fro, leg lengths
        "lift": (0.05, 0.4, False),  # leg lengths
        "lag": (-0.1, 0.1, False),  # of the lift, periods
        "crouch": (0.0, 0.15, False),  # leg lengths
        "sway": (-0.1, 0.1, False),  # of the body to the side, leg lengths
        "sway_phase": (0.0, 1.0, False),  # periods
        "shift": (-0.15, 0.15, True),  # of a pair of feet forwards, leg lengths
        "phase": (0.0, 1.0, True),  # of a pair of feet, periods
    }
    CYCLIC = ("phase", "sway_phase")
    MUTATION = 0.08  # standard deviation, of a gene's range
    RIVALS = 8  # robots of whom the fittest one is the parent
    FALL = 0.5  # leg lengths by which a fall lowers the fitness, for each second of a trial
    FROUDE = 0.3  # of a speed beyond which a gait is not fitter: v^2 / (g L)
    AGAIN = 0.05  # share of trials in which a robot tries its remembered gait again; luck does not stay
    LAST_ROUND = 0.2  # share of the warm-up, at its end, in which robots try what they remember and nothing else
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
    ) -> None:
        super().__init__()
        self._length = robot.leg_length
        self._dt, self._share = control_dt, mutation_share
        self._steps = max(round(trial / control_dt), 1)
        self._last_round = math.inf if steps is None else (1.0 - self.LAST_ROUND) * steps
        self._penalty = self.FALL * self._length * trial
        self._enough = math.sqrt(self.FROUDE * GRAVITY * self._length) * trial
        self._pendulum = math.sqrt(GRAVITY / self._length) / (2 * math.pi)
        group, lag = _groups(robot)
        self.register_buffer("pair_of", group, persistent=False)
        self.register_buffer("lagging", lag, persistent=False)
        self.register_buffer("joints", _joint_paths(robot, self.DAMPING * self._length), persistent=False)
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
        # No trial has begun.
        self.register_buffer("age", torch.full((num_robots,), -1, dtype=torch.int64))

    def _draw(self, count: int) -> dict[str, Tensor]:
        drawn = {}
        for name, (low, high, paired) in self.GENES.items():
            shape = (count, self.groups) if paired else (count,)
            drawn[name] = low + (high - low) * torch.rand(shape)
        return drawn | {name: value.expand(count, *value.shape).clone() for name, value in self._fixed.items()}

    def _children(self, count: int) -> dict[str, Tensor]:
        """Draw mutations of the fittest gaits among a few that robots remember, one for each robot."""
        rivals = torch.randint(count, (count, self.RIVALS))
        parent = rivals.gather(1, self.fitness[rivals].argmax(dim=1, keepdim=True))[:, 0]
        descends = (torch.rand(count) < self._share) & self.fitness[parent].isfinite()
        children = self._draw(count)
        for name, (low, high, paired) in self.GENES.items():
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
        fitness = (self.last - self.start).clamp(max=self._enough) - self._penalty * fell
        # Of a gait that was tried again the mean counts, in which the last trials weigh most.
        again = tried & self.again
        self.fitness.copy_(torch.where(again, 0.5 * (self.fitness + fitness), self.fitness))
        fitter = tried & ~again & (fitness > self.fitness)
        self.fitness.copy_(torch.where(fitter, fitness, self.fitness))
        children = self._children(len(ended))
        share = 1.0 if int(self.taken) >= self._last_round else self.AGAIN
        repeats = (torch.rand(len(ended)) < share) & self.fitness.isfinite()
        self.again.copy_(torch.where(ended, repeats, self.again))
        for name, (_, _, paired) in self.GENES.items():
            best, now = getattr(self, f"best_{name}"), getattr(self, name)
            best.copy_(torch.where(fitter[:, None] if paired else fitter, now, best))
            next_one = torch.where(repeats[:, None] if paired else repeats, best, children[name])
            now.copy_(torch.where(ended[:, None] if paired else ended, next_one, now))

    def forward(self, is_init: Tensor, position: Tensor) -> Tensor:
        """Return the actions ``[robots, A]`` of the next step.

        Args:
            is_init: Robots whose episode begins, bool ``[robots]``.
            position: Distance walked, ``[robots]`` (m).
        """
        ended = is_init | (self.age >= self._steps) | (self.age < 0)
        if ended.any():
            self.last.copy_(torch.where(is_init, self.last, position))
            self._end(ended, is_init)
            self.start.copy_(torch.where(ended, position, self.start))
            self.age.copy_(torch.where(ended, 0, self.age))
            self.cycles.copy_(torch.where(is_init, 0.0, self.cycles))
        self.last.copy_(position)
        self.age += 1
        self.taken += 1
        self.cycles += self._dt * self._pendulum * self.frequency
        action = self._act({name: getattr(self, name) for name in self.GENES}, self.cycles)
        return (action + self.NOISE * torch.randn_like(action)).clamp(-1.0, 1.0)

    def _act(self, genes: dict[str, Tensor], cycles: Tensor) -> Tensor:
        turn = 2 * math.pi
        phase = cycles[:, None] + genes["phase"][:, self.pair_of] + self.lagging
        forward = genes["shift"][:, self.pair_of] - genes["stride"][:, None] * torch.cos(turn * phase)
        lift = torch.sin(turn * (phase + genes["lag"][:, None])).clamp(min=0.0)
        up = genes["crouch"][:, None] + genes["lift"][:, None] * lift
        sway = genes["sway"] * torch.sin(turn * (cycles + genes["sway_phase"]))
        side = sway[:, None].expand_as(up)
        return torch.einsum("nfd,fda->na", self._length * torch.stack([forward, side, up], dim=-1), self.joints)

    def _fittest(self, count: int) -> dict[str, Tensor]:
        """Return the genes of the fittest gait, ``count`` times."""
        best = int(self.fitness.argmax())
        genes = {name: getattr(self, f"best_{name}")[best] for name in self.GENES}
        return {name: value.expand(count, *value.shape) for name, value in genes.items()}

    @property
    def tried(self) -> bool:
        """Return whether a gait was tried to its end."""
        return bool(self.fitness.isfinite().any())

    def fittest_action(self, phase: Tensor) -> Tensor:
        """Return the actions of the fittest gait after states of the given phases; all gaits keep to one frequency.

        Args:
            phase: Phase of the gait, ``[*]`` (periods).

        Returns:
            Actions, ``[*, A]``.
        """
        genes = self._fittest(len(phase))
        cycles = phase + self._dt * self._pendulum * genes["frequency"]
        return self._act(genes, cycles).clamp(-1.0, 1.0)

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


def _groups(robot: Robot) -> tuple[Tensor, Tensor]:
    """Return the number of each foot's pair, and the phase by which the second foot of a pair lags, each ``[feet]``."""
    group, lag, count = [-1] * len(robot.feet), [0.0] * len(robot.feet), 0
    for foot, other in enumerate(robot.mirror_feet):
        if group[foot] < 0:
            group[foot] = group[other] = count
            lag[other] = 0.5 if other != foot else 0.0
            count += 1
    return torch.tensor(group), torch.tensor(lag)


def _joint_paths(robot: Robot, damping: float) -> Tensor:
    """Return the actions by which each foot moves forwards, to the side and up: ``[feet, 3, A]`` (1/m)."""
    model, data = robot.model, mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    mujoco.mj_forward(model, data)
    scale = robot.action_map[1]
    paths = np.zeros((len(robot.feet), 3, len(robot.actuated)))
    for i, (foot, leg) in enumerate(zip(robot.feet, robot.legs, strict=True)):
        shared = {joint.name for k, other in enumerate(robot.legs) if k != i for joint in other}
        own = [joint for joint in leg if joint.name not in shared and joint.name in robot.actuated]
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, jacobian, None, robot.foot_place(data, foot), robot.foot_bodies[i])
        moved = robot.base.frame @ jacobian[:, [joint.qvel for joint in own]]
        # Damped least squares (Nakamura & Hanafusa 1986): a straight leg asks for no endless angles.
        inverse = moved.T @ np.linalg.inv(moved @ moved.T + damping**2 * np.eye(3))
        columns = [robot.actuated.index(joint.name) for joint in own]
        paths[i][:, columns] = inverse.T / scale[columns]
    if not paths.any():
        raise ConfigError(
            "exploration.warmup must not be stepping: no foot of the robot has a driven joint of its own."
        )
    return torch.from_numpy(paths).float()
