"""The commanded velocity: forward, to the left and turning, from a box that widens while a robot follows it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gctd3.errors import ConfigError, check_between
from gctd3.robots.array_library import array_namespace
from gctd3.tasks.heading import AXES, heading_velocity, yaw_rate
from gctd3.tasks.measurement import Measurement
from gctd3.tasks.memory import COMMAND
from gctd3.tasks.terms import Array, Command, Remembered, RobotFacts, Step, period

NAME = "velocity"  # of the command in the task
VELOCITY = f"{COMMAND}{NAME}"  # name of its array, shape [*, 3] (m/s, m/s, rad/s)
NEEDED = {"side": "side", "turn": "yaw"}  # coordinate of the base that an axis needs
SWAY = 0.5  # time constant with which the sway of a body that walks averages out (s)
TRAVELLED, WIDTH = "velocity_travelled", "velocity_width"


def velocities(now: Measurement, facts: RobotFacts) -> Array:
    """Return the velocities that a command is compared with, shape ``[*, 3]`` (m/s, m/s, rad/s)."""
    xp = array_namespace(now.velocity)
    return xp.stack([*heading_velocity(now, facts), yaw_rate(now, facts)], axis=-1)


@dataclass(frozen=True)
class _Smooth:
    """Average the velocities over the last steps: a filter of first order, with a time constant."""

    time: float

    def __call__(self, before: Array, step: Step) -> Array:
        share = 1.0 - math.exp(-step.facts.control_dt / self.time) if self.time > 0 else 1.0
        return before + share * (velocities(step.now, step.facts) - before)


def averaged(time: float) -> Remembered:
    """Declare the velocities averaged over a time constant (s), shape ``[*, 3]``: a body sways with every step."""
    return Remembered(f"velocity[{time:g} s]", (3,), velocities, _Smooth(time))


@dataclass(frozen=True)
class _Travel:
    """Sum by how much a robot moves faster than commanded since the command was drawn."""

    every: float

    def __call__(self, before: Array, step: Step) -> Array:
        begins = step.before[f"{VELOCITY}.left"] == period(self.every, step.facts.control_dt)
        # On its way to the one that was drawn the command changes with each step.
        return step.xp.where(begins[..., None], 0.0, before) + velocities(step.now, step.facts) - step.before[VELOCITY]


@dataclass(frozen=True)
class _Widen:
    """Compute a robot's share of the box: more after a command that it followed, less after one that it did not."""

    travel: _Travel
    by: float
    error: float
    turn_error: float

    def __call__(self, before: Array, step: Step) -> Array:
        xp, left = step.xp, step.before[f"{VELOCITY}.left"]
        off = self.travel(step.before[TRAVELLED], step) / period(self.travel.every, step.facts.control_dt)
        near = xp.sqrt(off[..., 0] ** 2 + off[..., 1] ** 2) <= self.error
        followed = near & (xp.abs(off[..., 2]) <= self.turn_error)
        width = xp.clip(before + xp.where(followed, self.by, -self.by / 2), 0.0, 1.0)
        return xp.where(left <= 1, width, before)


@dataclass(frozen=True)
class VelocityCommand(Command):
    """Draw the velocity that the robot is to have: forward and to the left of its heading (m/s), and turning (rad/s).

    With :attr:`begin` a robot of a training begins with commands to walk straight ahead. After each command that it
    followed on average its box is wider by a share :attr:`widen`, up to the whole one, and after one that it did not
    follow narrower by half of that. Evaluations draw from the whole box.

    What a robot is told changes by at most :attr:`acceleration`, from standing still at the beginning of an episode on,
    since no body can follow a jump of the command, and most falls came with one, as from fast forward to backward.
    Exported policies limit what they are told in the same way.

    Attributes:
        forward: Lowest and highest velocity forward; negative is backward (m/s).
        side: Lowest and highest velocity to the left; negative is to the right (m/s).
        turn: Lowest and highest yaw rate; to the left is positive (rad/s).
        standing: Share of commands to stand still.
        extreme: Share of commands of which each number is its lowest, 0 or its highest one: straight ahead, a turn on
            the spot, or all at once, which few of the commands in between are like.
        begin: Lowest and highest velocity forward of the first commands (m/s); ``None`` for the whole box from the
            beginning.
        acceleration: Largest change of the command a second, forward, to the left and of the yaw rate (m/s^2, m/s^2,
            rad/s^2); ``None`` for one that jumps.
        widen: Share of the box that is added after a command that was followed.
        error: Largest distance of the mean velocity from the command with which it counts as followed (m/s).
        turn_error: The same of the mean yaw rate (rad/s).
    """

    forward: Sequence[float] = (-0.5, 1.0)
    side: Sequence[float] = (-0.4, 0.4)
    turn: Sequence[float] = (-0.8, 0.8)
    standing: float = 0.1
    extreme: float = 0.3
    begin: Sequence[float] | None = None
    acceleration: Sequence[float] | None = (2.0, 2.0, 4.0)
    widen: float = 0.2
    error: float = 0.25
    turn_error: float = 0.3

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in AXES:
            _check_range(name, getattr(self, name))
        check_between(self, 0, 1, "standing", "extreme", "widen")
        for name in ("error", "turn_error"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} must be above 0, got {getattr(self, name)}.")
        given = self.acceleration
        if given is not None and (len(given) != len(AXES) or not all(0 < value < math.inf for value in given)):
            raise ConfigError(f"acceleration must be three numbers above 0, or null, got {list(given)}.")
        if self.begin is not None:
            _check_range("begin", self.begin)
            (low, high), (first, last) = self.forward, self.begin
            if not low <= first <= last <= high:
                raise ConfigError(f"begin must lie within forward, {[low, high]}, got {[first, last]}.")

    @property
    def size(self) -> int:
        """Return the length of the command."""
        return len(AXES)

    @property
    def box(self) -> np.ndarray:
        """Return the lowest and the highest number of each axis, shape ``[3, 2]`` (m/s, m/s, rad/s)."""
        return np.array([self.forward, self.side, self.turn], dtype=np.float64)

    @property
    def reach(self) -> np.ndarray:
        """Return :attr:`box`, with 0 in it if some commands are to stand, shape ``[3, 2]`` (m/s, m/s, rad/s)."""
        low, high = self.box.T
        return np.stack([np.minimum(low, 0.0), np.maximum(high, 0.0)], axis=-1) if self.standing else self.box

    @property
    def slew_rates(self) -> np.ndarray | None:
        """Return the largest change of the command a second, shape ``[3]`` (m/s^2, m/s^2, rad/s^2)."""
        return None if self.acceleration is None else np.array(self.acceleration, dtype=np.float64)

    @property
    def still(self) -> np.ndarray:
        """Return the command to stand, or the one that is nearest to it, shape ``[3]``."""
        return np.clip(np.zeros(len(AXES)), *self.reach.T)

    def fitted(self, facts: RobotFacts) -> VelocityCommand:
        """Return the command for a robot: without the axes along which its base cannot move."""
        lacking: dict[str, Any] = {axis: (0.0, 0.0) for axis, needed in NEEDED.items() if needed not in facts.base}
        return replace(self, **lacking) if lacking else self

    def evaluated(self) -> VelocityCommand:
        """Return the command without its curriculum."""
        return replace(self, begin=None)

    def remembers(self) -> tuple[Remembered, ...]:
        """Return the arrays of the curriculum: what was travelled under the command, and each robot's share of the box.

        The share outlasts episodes.
        """
        if self.begin is None:
            return ()
        travel = _Travel(self.every)
        widen = _Widen(travel, self.widen, self.error, self.turn_error)
        return Remembered(TRAVELLED, (3,), 0.0, travel), Remembered(WIDTH, (), 0.0, widen, lasting=True)

    def __call__(self, rng: np.random.Generator | np.random.RandomState, count: int) -> np.ndarray:
        """Draw a command from the whole box for each of ``count`` robots, shape ``[count, 3]``."""
        return self._drawn(rng, np.broadcast_to(self.box, (count, 3, 2)))

    def draw(
        self, rng: np.random.Generator | np.random.RandomState, count: int, memory: Mapping[str, Array]
    ) -> np.ndarray:
        """Draw a command for each robot of a memory from its share of the box, shape ``[count, 3]``."""
        if self.begin is None:
            return self(rng, count)
        width = np.asarray(memory[WIDTH]).reshape(-1, 1, 1)
        first = np.array([self.begin, (0.0, 0.0), (0.0, 0.0)], dtype=np.float64)
        return self._drawn(rng, first + width * (self.box - first))

    def _drawn(self, rng: np.random.Generator | np.random.RandomState, box: np.ndarray) -> np.ndarray:
        drawn = rng.uniform(box[..., 0], box[..., 1])
        ends = np.stack([box[..., 0], np.clip(0.0, box[..., 0], box[..., 1]), box[..., 1]])
        which = (3 * rng.uniform(size=(1, *drawn.shape))).astype(np.int64)
        at_ends = np.take_along_axis(ends, which, axis=0)[0]
        drawn = np.where(rng.uniform(size=(len(box), 1)) < self.extreme, at_ends, drawn)
        stands = rng.uniform(size=len(box)) < self.standing
        return np.where(stands[:, None], 0.0, drawn)


@dataclass(frozen=True)
class HeldCommand(Command):
    """Give each robot one command for the whole episode, for evaluations.

    Attributes:
        rows: A command for each robot; robots beyond the last one begin again with the first.
        like: Command of the task, which says from where and how fast these are approached; ``None`` for at once.
    """

    every: float = 1e6
    rows: Sequence[Sequence[float]] = ((0.0, 0.0, 0.0),)
    like: Command | None = None

    @property
    def size(self) -> int:
        """Return the length of the command."""
        return len(self.rows[0])

    @property
    def slew_rates(self) -> np.ndarray | None:
        """Return the largest change of the command a second, shape ``[3]``; ``None`` for one that jumps."""
        return None if self.like is None else self.like.slew_rates

    @property
    def still(self) -> np.ndarray:
        """Return the command with which an episode begins, shape ``[3]``."""
        return super().still if self.like is None else self.like.still

    def __call__(self, rng: np.random.Generator | np.random.RandomState, count: int) -> np.ndarray:
        """Return the robots' commands, shape ``[count, 3]``."""
        rows = np.asarray(self.rows, dtype=np.float64)
        return rows[np.arange(count) % len(rows)]


def _check_range(name: str, values: Sequence[float]) -> None:
    if len(values) != 2 or not values[0] <= values[1]:
        raise ConfigError(f"{name} must be [lowest, highest], got {list(values)}.")
