"""Settings of evaluations: the number of episodes and the perturbations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gctd3.errors import ConfigError, check_between, check_seed
from gctd3.tasks.heading import AXES

SETTLE = 1.0  # after a new command, which is not counted (s)


@dataclass(frozen=True, kw_only=True)
class EpisodeSettings:
    """Set the number of evaluated episodes and the seed of their starts, for all commands that evaluate.

    Attributes:
        episodes: Episodes, each from its own start.
        seed: Seed of the starts.
        threads: CPU threads that simulate; ``None`` for all cores. Results do not depend on it.
    """

    episodes: int = 50
    seed: int = 10_000
    threads: int | None = None

    def __post_init__(self) -> None:
        if self.episodes < 1:
            raise ConfigError(f"episodes must be at least 1, got {self.episodes}.")
        check_seed("seed", self.seed)


@dataclass(frozen=True)
class Perturbations:
    """Set the perturbations that a policy is tested with, one at a time; the rest is as it was in training.

    Attributes:
        impulses: Impulses of the pushes on the body, forward and backward, in rising order (N s), each instantaneous.
        phases: Number of equal parts of the stride, at the beginning of each of which robots are pushed.
        starts: Pushes of each impulse, phase and direction, each in an episode of its own.
        settle: Distance after which a robot is pushed (m).
        recover: Time for which the robot has to go on without a termination after the push (s).
        masses: Factors of all the robot's masses and inertias.
        frictions: Factors of all friction, including the ground's.
        delays: Delays of the actions (control steps).
        angle_noise: Standard deviation of the errors of angles (rad).
        velocity_noise: Standard deviation of the errors of angular velocities (rad/s).
        height_noise: Standard deviation of the errors of the body's height (m).
        speed_noise: Standard deviation of the errors of the body's velocity (m/s).
        shove: Change of the whole robot's velocity by each of the pushes in random horizontal directions under which
            robots of tasks with a commanded velocity are to go on (m/s); 0 for none.
        shove_every: Time from one of these to the next (s).
    """

    impulses: Sequence[float] = (4.0, 8.0, 12.0, 16.0, 20.0, 25.0, 30.0, 40.0)
    phases: int = 8
    starts: int = 5
    settle: float = 5.0
    recover: float = 3.0
    masses: Sequence[float] = (0.8, 1.2)
    frictions: Sequence[float] = (0.5, 1.5)
    delays: Sequence[int] = (1, 2)
    angle_noise: float = 0.02
    velocity_noise: float = 0.5
    height_noise: float = 0.005
    speed_noise: float = 0.05
    shove: float = 0.5
    shove_every: float = 2.0

    def __post_init__(self) -> None:
        check_between(self, 1, 1000, "phases", "starts")
        check_between(self, 0, 1000, "settle", "angle_noise", "velocity_noise", "height_noise", "speed_noise", "shove")
        impulses = list(self.impulses)
        if not impulses or impulses != sorted(set(impulses)) or not impulses[0] > 0:
            raise ConfigError(f"impulses must hold numbers above 0 that rise, got {impulses}.")
        for name in ("masses", "frictions"):
            if any(not factor > 0 for factor in getattr(self, name)):
                raise ConfigError(f"{name} must hold factors above 0, got {list(getattr(self, name))}.")
        if any(not 1 <= steps <= 1000 for steps in self.delays):
            raise ConfigError(f"delays must hold whole numbers from 1 to 1,000, got {list(self.delays)}.")
        for name in ("recover", "shove_every"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} must be above 0 s, got {getattr(self, name)}.")


@dataclass(frozen=True)
class CommandGrid:
    """Set the commands that a policy is tested with: every combination, and standing still.

    Attributes:
        forward: Velocities forward (m/s): a number of them, evenly spaced over the range of the training, or a list.
        side: Velocities to the left (m/s), in the same way.
        turn: Yaw rates (rad/s), in the same way.
        starts: Episodes of each command, each from its own start.
        seconds: Time for which a command is held (s).
    """

    forward: int | Sequence[float] = 5
    side: int | Sequence[float] = 3
    turn: int | Sequence[float] = 3
    starts: int = 2
    seconds: float = 8.0

    def __post_init__(self) -> None:
        for name in AXES:
            value = getattr(self, name)
            if isinstance(value, int):
                check_between(self, 1, 100, name)
            elif not value:
                raise ConfigError(f"{name} must be a number of velocities, or a list of them, got {list(value)}.")
        check_between(self, 1, 1000, "starts")
        if not SETTLE < self.seconds <= 1000:
            raise ConfigError(
                f"seconds must be above {SETTLE:g}, the time that a robot has to settle, and at most 1000, got "
                f"{self.seconds}."
            )

    def commands(self, box: np.ndarray) -> np.ndarray:
        """Return every combination, and standing still, shape ``[K, 3]`` (m/s, m/s, rad/s).

        Args:
            box: Lowest and highest velocities of the training, over which numbers of them are spaced, shape ``[3, 2]``.
        """
        columns = []
        for name, (low, high) in zip(AXES, box, strict=True):
            asked = getattr(self, name)
            if not isinstance(asked, int):
                columns.append(np.asarray(asked, dtype=np.float64))
            else:
                columns.append(np.unique(np.linspace(low, high, asked) if asked > 1 else [(low + high) / 2]))
        rows = np.stack(np.meshgrid(*columns, indexing="ij"), axis=-1).reshape(-1, 3)
        # A grid of an odd number of velocities may have it already.
        rows[np.abs(rows) < 1e-12] = 0.0
        return rows if (rows == 0).all(axis=1).any() else np.concatenate([np.zeros((1, 3)), rows])
