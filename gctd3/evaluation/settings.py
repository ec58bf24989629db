"""Settings of evaluations: the number of episodes and the perturbations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gctd3.errors import ConfigError, check_between, check_seed


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

    def __post_init__(self) -> None:
        check_between(self, 1, 1000, "phases", "starts")
        check_between(self, 0, 1000, "settle", "angle_noise", "velocity_noise", "height_noise", "speed_noise")
        impulses = list(self.impulses)
        if not impulses or impulses != sorted(set(impulses)) or not impulses[0] > 0:
            raise ConfigError(f"impulses must hold numbers above 0 that rise, got {impulses}.")
        for name in ("masses", "frictions"):
            if any(not factor > 0 for factor in getattr(self, name)):
                raise ConfigError(f"{name} must hold factors above 0, got {list(getattr(self, name))}.")
        if any(not 1 <= steps <= 1000 for steps in self.delays):
            raise ConfigError(f"delays must hold whole numbers from 1 to 1,000, got {list(self.delays)}.")
        if not self.recover > 0:
            raise ConfigError(f"recover must be above 0 s, got {self.recover}.")
