"""The task of following a commanded velocity: forward, to the side, turning, or standing still."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ClassVar

from gctd3.errors import ConfigError
from gctd3.robots.array_library import array_namespace
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.feature_table import FeatureTable
from gctd3.tasks.heading import AXES
from gctd3.tasks.motor_terms import ActionRate, Effort, EndStops
from gctd3.tasks.randomisations import JointNoise
from gctd3.tasks.reward import Reward
from gctd3.tasks.reward_terms import Ended, Living, Tilt
from gctd3.tasks.simulated_task import Composition, SimulatedTask
from gctd3.tasks.terminations import Fall, Survive
from gctd3.tasks.terms import Array, Command, Randomisation, RewardTerm, Termination
from gctd3.tasks.velocity_command import NAME, NEEDED, VelocityCommand
from gctd3.tasks.velocity_features import AVERAGED, COMMANDS, privileged_features, velocity_features
from gctd3.tasks.velocity_terms import StandStill, TrackVelocity, TrackYawRate

EPISODE = 1000  # control steps: four commands


def velocity_terms() -> dict[str, RewardTerm]:
    """Return the terms of the reward; each step is worth something, so that falling never beats walking badly."""
    return {
        "track": TrackVelocity(weight=3.0),
        "track_turn": TrackYawRate(weight=1.0),
        "stand_still": StandStill(),
        "living": Living(weight=0.5),
        "fall": Ended(),
        "tilt": Tilt(),
        "action_rate": ActionRate(),
        "effort": Effort(),
        "end_stops": EndStops(),
    }


@dataclass(frozen=True)
class VelocityReward(Reward):
    """Hold the terms of the reward for following a commanded velocity.

    A YAML names only those that it adds, changes or leaves out. Pay that is linear in the error teaches a robot that
    stands to walk; an exponential one (``reward=tracking``) does not.

    Attributes:
        terms: Terms by name, in the order of their sum; ``None`` leaves one out.
    """

    BY_NAME: ClassVar[tuple[str, ...]] = ("terms",)

    terms: Mapping[str, Any] = field(default_factory=velocity_terms)


def _terminations() -> dict[str, Termination]:
    # Heights are in leg lengths, and shanks may graze the ground. The time limit truncates an episode: its value is
    # bootstrapped, and it counts as a success.
    return {"fall": Fall(height=None, shanks=False), "time_limit": Survive(EPISODE)}


def _randomisations() -> dict[str, Randomisation]:
    return {"joint_noise": JointNoise()}


def _commands() -> dict[str, Command]:
    return {NAME: VelocityCommand()}


@dataclass(frozen=True)
class VelocitySettings(Composition):
    """Hold the settings of the task of following a commanded velocity; see :class:`.Composition`.

    Attributes:
        features: Features of the nodes that the policy observes, which robots have sensors for.
        privileged: Features of the nodes that only critics observe.
        terminations: A fall, and the time limit.
        randomisations: Randomisations of the start: noise on every joint.
        commands: The commanded velocity, by the name ``velocity``.
    """

    features: Mapping[str, Any] = field(default_factory=velocity_features)
    privileged: Mapping[str, Any] = field(default_factory=privileged_features)
    terminations: Mapping[str, Any] = field(default_factory=_terminations)
    randomisations: Mapping[str, Any] = field(default_factory=_randomisations)
    commands: Mapping[str, Any] = field(default_factory=_commands)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.commands.get(NAME) is None:
            raise ConfigError(f"commands must hold a command by the name {NAME}, got {', '.join(self.commands)}.")

    def build(self, robot: RobotSettings, reward: Reward | None = None) -> VelocityTask:
        """Build the task, its robot and its graph; under :class:`VelocityReward` if ``reward`` is ``None``."""
        loaded = robot.load()
        asked = VelocityReward() if reward is None else reward
        return VelocityTask(loaded, asked, self, robot.graph_of(loaded))


class VelocityTask(SimulatedTask):
    """Define the task of following a commanded velocity on a robot; see :class:`.SimulatedTask`."""

    name = "velocity"
    abilities = SimulatedTask.abilities | {"commands"}

    @property
    def shown_command(self) -> Callable[[Array], Array] | None:
        """Return a function that reads the command from observations, ``None`` if they do not show all of it.

        It takes observations of the nodes, ``[*, N, F * H]``, of NumPy or PyTorch, and returns the velocity forward and
        to the left and the yaw rate, ``[*, 3]`` (m/s, m/s, rad/s); 0 for what the base cannot do.
        """
        known, asked = set(_names(self.table)), self._of_base(COMMANDS)
        return partial(self._command, asked) if known.issuperset(filter(None, asked)) else None

    @property
    def shown_velocity(self) -> Callable[[Array], Array] | None:
        """Return a function that reads the averaged velocity from what critics observe, ``None`` if it is not there.

        It takes counters, ``[*, K]``, and returns the velocity forward and to the left and the yaw rate, ``[*, 3]``
        (m/s, m/s, rad/s); 0 for what the base cannot do.
        """
        asked = self._of_base(AVERAGED)
        known = [] if self.privileged is None else _names(self.privileged)
        return partial(self._velocity, known, asked) if set(known).issuperset(filter(None, asked)) else None

    def _of_base(self, names: Sequence[str]) -> list[str | None]:
        """Return the name of each axis, ``None`` for one along which the base cannot move."""
        return [
            name if NEEDED.get(axis) in (None, *self.facts.base) else None
            for axis, name in zip(AXES, names, strict=True)
        ]

    def _command(self, asked: Sequence[str | None], nodes: Array) -> Array:
        xp, newest = array_namespace(nodes), nodes[..., (self.history - 1) * self.features :]
        nothing = xp.zeros_like(newest[..., 0, 0])
        return xp.stack(
            [nothing if name is None else newest[(..., *self.table.place(name))] for name in asked], axis=-1
        )

    @staticmethod
    def _velocity(known: Sequence[str], asked: Sequence[str | None], counters: Array) -> Array:
        xp, numbers = array_namespace(counters), counters[..., counters.shape[-1] - len(known) :]
        nothing = xp.zeros_like(counters[..., 0])
        return xp.stack([nothing if name is None else numbers[..., known.index(name)] for name in asked], axis=-1)

    def command_ranges(self) -> dict[str, tuple[float, float]]:
        """Return the range of each number of the command by the name of its reading (m/s, m/s, rad/s).

        It holds 0 if some commands are to stand.
        """
        known, reach = set(_names(self.table)), self.commands[NAME].reach.tolist()
        return {name: (low, high) for name, (low, high) in zip(COMMANDS, reach, strict=True) if name in known}

    def command_slew_rates(self) -> dict[str, float]:
        """Return by how much each number of the command changes a second at most, by the name of its reading."""
        known, rates = set(_names(self.table)), self.commands[NAME].slew_rates
        if rates is None:
            return {}
        return {name: rate for name, rate in zip(COMMANDS, rates.tolist(), strict=True) if name in known}


def _names(table: FeatureTable) -> list[str]:
    """Return the names of the numbers that a table holds, in their order."""
    return [reading.name for row in table.readings for reading in row if reading is not None]
