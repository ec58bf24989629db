"""Domain randomisation: robots that differ from episode to episode, so that a policy suits the real one too.

Tobin et al. 2017 (arXiv:1703.06907); the kinds of differences are those of Rudin et al. 2022 (arXiv:2109.11978) and of
mjlab's tasks of legged robots. What an episode has drawn is in its memory, so that a training continues exactly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from gctd3.errors import ConfigError, check_between
from gctd3.robots.altered import altered_model, resting_action
from gctd3.robots.robot import Robot
from gctd3.tasks.feature_table import FeatureTable

Generator = np.random.Generator | np.random.RandomState
# Names in the memory: the robot's model, its encoders' errors, the delay of its actions, those that wait, control steps
# to the next push, and the errors of the present frame.
MODEL, BIAS, DELAY, WAITING, PUSH, NOISE = (
    f"domain.{name}" for name in ("model", "encoder_bias", "delay", "waiting", "push", "noise")
)
NONE = (1.0, 1.0)


@dataclass(frozen=True)
class DomainRandomisation:
    """Hold the differences between robots in a training; evaluations have none. By default there is none.

    Keys that are also those of :class:`.Perturbations`, with which robustness is evaluated, mean the same.

    Attributes:
        masses: Lowest and highest factor of all the robot's masses and inertias.
        frictions: Lowest and highest factor of all friction, including the ground's.
        gains: Lowest and highest factor of the servos' stiffness and damping.
        centre_of_mass: Largest shift of the root body's centre of mass along each of its axes (m).
        models: Number of different models with these four. Each episode has one of them; each takes as much memory as
            the robot's own, with its meshes.
        encoder_bias: Largest constant error of each joint's encoder in an episode (rad); the servo has it too.
        delays: Smallest and largest delay of the actions, constant in an episode (control steps).
        angle_noise: Standard deviation of the errors of angles (rad), and of the direction of gravity.
        velocity_noise: Standard deviation of the errors of angular velocities (rad/s).
        height_noise: Standard deviation of the errors of the body's height (m).
        speed_noise: Standard deviation of the errors of the body's velocity (m/s).
        pushes: Smallest and largest push in a random horizontal direction, as the change of the whole robot's velocity
            (N s for each kilogram, m/s).
        push_every: Shortest and longest time from one push to the next (s).
    """

    masses: Sequence[float] = NONE
    frictions: Sequence[float] = NONE
    gains: Sequence[float] = NONE
    centre_of_mass: float = 0.0
    models: int = 16
    encoder_bias: float = 0.0
    delays: Sequence[int] = (0, 0)
    angle_noise: float = 0.0
    velocity_noise: float = 0.0
    height_noise: float = 0.0
    speed_noise: float = 0.0
    pushes: Sequence[float] = (0.0, 0.0)
    push_every: Sequence[float] = (3.0, 8.0)

    def __post_init__(self) -> None:
        for name in ("masses", "frictions", "gains", "push_every"):
            _check_range(name, getattr(self, name))
            if not getattr(self, name)[0] > 0:
                raise ConfigError(f"{name} must be above 0, got {list(getattr(self, name))}.")
        for name, most in (("delays", 100), ("pushes", 100)):
            low, high = _check_range(name, getattr(self, name))
            if not 0 <= low <= high <= most:
                raise ConfigError(f"{name} must be between 0 and {most}, got {[low, high]}.")
        check_between(self, 0, 1, "centre_of_mass", "encoder_bias")
        check_between(self, 1, 10_000, "models")
        check_between(self, 0, 1000, "angle_noise", "velocity_noise", "height_noise", "speed_noise")

    @property
    def alters(self) -> bool:
        """Return whether models differ."""
        ranges = (self.masses, self.frictions, self.gains)
        return self.centre_of_mass > 0 or any(tuple(one) != NONE for one in ranges)

    def draw_models(self, rng: np.random.Generator) -> np.ndarray:
        """Draw the numbers of each model: factors of mass, friction and gains, and the shift. Shape ``[models, 6]``.

        Each number is spread evenly over its range (a Latin hypercube, McKay et al. 1979).
        """
        low = np.array([self.masses[0], self.frictions[0], self.gains[0], *[-self.centre_of_mass] * 3])
        high = np.array([self.masses[1], self.frictions[1], self.gains[1], *[self.centre_of_mass] * 3])
        count = self.models if self.alters else 1
        cells = np.stack([rng.permutation(count) for _ in low], axis=1)
        return low + (high - low) * (cells + rng.uniform(size=cells.shape)) / count


def build_models(robot: Robot, numbers: np.ndarray) -> list[mujoco.MjModel]:
    """Build the models of :meth:`DomainRandomisation.draw_models`.

    Raises:
        MemoryError: If there is not enough memory for so many.
    """
    return [altered_model(robot, float(m), float(f), float(g), np.array(shift)) for m, f, g, *shift in numbers]


class Domain:
    """Draw and keep what differs in the episodes of one task.

    Args:
        settings: The differences.
        robot: The robot.
        table: Features of its nodes.
        servo_joints: Index of each servo's joint among ``robot.joints``, shape ``[A]``.
        control_dt: Control period (s).
    """

    def __init__(
        self,
        settings: DomainRandomisation,
        robot: Robot,
        table: FeatureTable,
        servo_joints: np.ndarray,
        control_dt: float,
    ) -> None:
        self.settings, self.control_dt, self.servo_joints = settings, control_dt, servo_joints
        self.joints = len(robot.joints)
        self._rest = resting_action(robot)
        s = settings
        errors = {"angle": s.angle_noise, "direction": s.angle_noise, "angular velocity": s.velocity_noise}
        self._deviation = table.deviations({**errors, "length": s.height_noise, "velocity": s.speed_noise})
        self._encoders = table.encoders()
        self.models = s.models if s.alters else 1

    def begin(self, shape: tuple[int, ...], rng: Generator) -> dict[str, np.ndarray]:
        """Draw what an episode has, for robots of a shape."""
        s, waiting = self.settings, int(self.settings.delays[1])
        bias = rng.uniform(-s.encoder_bias, s.encoder_bias, (*shape, self.joints))
        return {
            MODEL: np.asarray(_integers(rng, 0, self.models - 1, shape)),
            BIAS: bias,
            DELAY: np.asarray(_integers(rng, int(s.delays[0]), waiting, shape)),
            WAITING: np.broadcast_to(self._rest, (*shape, waiting, len(self._rest))).copy(),
            PUSH: self._wait(shape, rng),
            NOISE: self._noise(bias, rng),
        }

    def advance(self, before: Mapping[str, np.ndarray], action: np.ndarray, rng: Generator) -> dict[str, np.ndarray]:
        """Return what the memory holds after a step with a policy's action ``[*, A]``."""
        left, waiting = before[PUSH] - 1, before[WAITING]
        over = np.asarray(left <= 0)
        if waiting.shape[-2]:
            waiting = np.concatenate([waiting[..., 1:, :], np.asarray(action)[..., None, :]], axis=-2)
        return {
            MODEL: before[MODEL],
            BIAS: before[BIAS],
            DELAY: before[DELAY],
            WAITING: waiting,
            PUSH: np.where(over, self._wait(over.shape, rng), left) if over.any() else left,
            NOISE: self._noise(before[BIAS], rng),
        }

    def applied(self, memory: Mapping[str, np.ndarray], action: np.ndarray) -> np.ndarray:
        """Return the action that arrives at the servos in this step, shape ``[N, A]``."""
        recent = np.concatenate([memory[WAITING], action[:, None]], axis=1)
        return np.asarray(recent[np.arange(len(action)), -1 - memory[DELAY]])

    def servo_bias(self, memory: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the error of the encoder of each servo, shape ``[N, A]`` (rad)."""
        return np.asarray(memory[BIAS][:, self.servo_joints])

    def pushed(self, memory: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the indices of the robots that are pushed before this step."""
        return np.flatnonzero(memory[PUSH] <= 1) if self.settings.pushes[1] > 0 else np.zeros(0, dtype=np.int64)

    def draw_push(self, rng: np.random.Generator) -> np.ndarray:
        """Draw a push: change of velocity forward and to the left, shape ``[2]`` (m/s)."""
        low, high = self.settings.pushes
        size, way = rng.uniform(low, high), rng.uniform(0.0, 2.0 * np.pi)
        return np.array([size * np.cos(way), size * np.sin(way)])

    def _wait(self, shape: tuple[int, ...], rng: Generator) -> np.ndarray:
        low, high = self.settings.push_every
        steps = np.round(np.asarray(rng.uniform(low, high, shape)) / self.control_dt)
        return np.maximum(1, steps).astype(np.int64)

    def _noise(self, bias: np.ndarray, rng: Generator) -> np.ndarray:
        noise = np.zeros((*bias.shape[:-1], *self._deviation.shape), dtype=np.float32)
        if self._deviation.any():
            noise += self._deviation * rng.normal(size=noise.shape)
        node, number, joint = self._encoders
        noise[..., node, number] += bias[..., joint]
        return noise


def _integers(rng: Generator, low: int, high: int, shape: tuple[int, ...]) -> np.ndarray:
    draw = rng.integers if isinstance(rng, np.random.Generator) else rng.randint
    return np.asarray(draw(low, high + 1, shape))


def _check_range(name: str, values: Sequence[float]) -> tuple[float, float]:
    if len(values) != 2 or not values[0] <= values[1]:
        raise ConfigError(f"{name} must be [lowest, highest], got {list(values)}.")
    return values[0], values[1]
