"""The task of jumping to a commanded height, and standing after the landing."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from gctd3.errors import ConfigError
from gctd3.robots.array_library import array_namespace
from gctd3.robots.graph import KinematicGraph
from gctd3.robots.robot import Robot
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.jump_command import NAME, JumpCommand
from gctd3.tasks.jump_features import (
    COMMANDED,
    COSINE,
    DECIMETRES,
    SINE,
    JumpClock,
    jump_features,
    jump_privileged,
)
from gctd3.tasks.jump_terms import JumpedAndStood, JumpHeight, LeaveSpot, StandAfterJump
from gctd3.tasks.motor_terms import ActionRate, Effort
from gctd3.tasks.randomisations import JointNoise
from gctd3.tasks.reward import Reward
from gctd3.tasks.reward_terms import Ended, Tilt
from gctd3.tasks.simulated_task import Composition, SimulatedTask
from gctd3.tasks.terminations import Fall, TimeLimit
from gctd3.tasks.terms import Array, Command, Randomisation, RewardTerm, Termination


def jump_terms() -> dict[str, RewardTerm]:
    """Return the terms of the reward; a jump changes its actions fast, and takes the whole torque."""
    return {
        "jump": JumpHeight(),
        "stand": StandAfterJump(),
        "fall": Ended(),
        "tilt": Tilt(),
        "spot": LeaveSpot(),
        "action_rate": ActionRate(weight=-0.02),
        "effort": Effort(weight=-0.05),
    }


@dataclass(frozen=True)
class JumpReward(Reward):
    """Hold the terms of the reward of a jump; a YAML names only those that it adds, changes or leaves out.

    Attributes:
        terms: Terms by name, in the order of their sum; ``None`` leaves one out. Little is paid for anything but the
            jump and the standing after it.
    """

    BY_NAME: ClassVar[tuple[str, ...]] = ("terms",)

    terms: Mapping[str, Any] = field(default_factory=jump_terms)


def _terminations() -> dict[str, Termination]:
    return {
        # Heights are in leg lengths; a landing may be deep, and shanks may graze the ground.
        "fall": Fall(height=None, drop=0.6, shanks=False),
        # It and the time limit truncate an episode: its value is bootstrapped.
        "finish": JumpedAndStood(),
        "time_limit": TimeLimit(JumpedAndStood.steps),
    }


def _randomisations() -> dict[str, Randomisation]:
    return {"joint_noise": JointNoise()}


def _commands() -> dict[str, Command]:
    return {NAME: JumpCommand()}


@dataclass(frozen=True)
class JumpSettings(Composition):
    """Hold the settings of the task of jumping to a commanded height; see :class:`.Composition`.

    Attributes:
        history: Number of frames stacked into an observation: few, as the clock tells where the robot is in the jump.
        features: Features of the nodes that the policy observes, which robots have sensors for.
        privileged: Features of the nodes that only critics observe.
        terminations: A fall, standing for a second after a jump that is high enough, and the time limit.
        randomisations: Randomisations of the start: noise on every joint.
        commands: The commanded height, by the name ``jump``.
    """

    history: int = 3
    features: Mapping[str, Any] = field(default_factory=jump_features)
    privileged: Mapping[str, Any] = field(default_factory=jump_privileged)
    terminations: Mapping[str, Any] = field(default_factory=_terminations)
    randomisations: Mapping[str, Any] = field(default_factory=_randomisations)
    commands: Mapping[str, Any] = field(default_factory=_commands)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.commands.get(NAME), JumpCommand):
            raise ConfigError(
                f"commands must hold a JumpCommand by the name {NAME}, got {', '.join(self.commands) or 'none'}."
            )

    def build(self, robot: RobotSettings, reward: Reward | None = None) -> JumpTask:
        """Build the task, its robot and its graph; under :class:`JumpReward` if ``reward`` is ``None``."""
        loaded = robot.load()
        return JumpTask(loaded, JumpReward() if reward is None else reward, self, robot.graph_of(loaded))


class JumpTask(SimulatedTask):
    """Define the task of jumping to a commanded height on a robot; see :class:`.SimulatedTask`."""

    name = "jump"

    def __init__(
        self, robot: Robot, reward: Reward, settings: Composition, graph: KinematicGraph | None = None
    ) -> None:
        super().__init__(robot, reward, settings, graph)
        clocks = [feature for feature in settings.features.values() if isinstance(feature, JumpClock)]
        # All feet together: the pattern of the jump is that of the clock.
        self.gait = clocks[0].pattern(robot) if clocks else None

    @property
    def levels(self) -> tuple[float, ...]:
        """Return the commanded heights, rising (m)."""
        return tuple(self.commands[NAME].levels)

    @property
    def shown_command(self) -> Callable[[Array], Array] | None:
        """Return a function that reads the commanded height from observations, ``None`` if they do not show it.

        It takes observations of the nodes, ``[*, N, F * H]``, of NumPy or PyTorch, and returns heights ``[*, 1]`` (m).
        """
        shown = any(one is not None and one.name == COMMANDED for row in self.table.readings for one in row)
        return self._height if shown else None

    def _height(self, nodes: Array) -> Array:
        newest = nodes[..., (self.history - 1) * self.features :]
        return newest[(..., *self.table.place(COMMANDED))][..., None] / DECIMETRES

    def phase(self, nodes: Array) -> Array:
        """Return the phase of the jump that observations show, in [0, 1) of the clock's period, ``[*]``."""
        xp, newest = array_namespace(nodes), nodes[..., (self.history - 1) * self.features :]
        sine, cosine = (newest[(..., *self.table.place(name))] for name in (SINE, COSINE))
        return (xp.atan2(sine, cosine) / (2 * math.pi)) % 1.0

    def command_ranges(self) -> dict[str, tuple[float, float]]:
        """Return the range of the commanded height by the name of its reading (dm)."""
        if self.shown_command is None:
            return {}
        return {COMMANDED: (DECIMETRES * self.levels[0], DECIMETRES * self.levels[-1])}
