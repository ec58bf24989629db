"""The task of following a commanded velocity: forward, to the side, turning, or standing still."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from array_api_compat import array_namespace

from gctd3.errors import ConfigError
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.motor_terms import ActionRate, Effort, EndStops
from gctd3.tasks.randomisations import JointNoise
from gctd3.tasks.reward import Reward
from gctd3.tasks.reward_terms import Ended, Living, Tilt
from gctd3.tasks.simulated_task import Composition, SimulatedTask
from gctd3.tasks.terminations import Fall, Survive
from gctd3.tasks.terms import Array, Command, Randomisation, RewardTerm, Termination
from gctd3.tasks.velocity_command import AXES, NAME, NEEDED, VelocityCommand
from gctd3.tasks.velocity_features import COMMANDS, privileged_features, velocity_features
from gctd3.tasks.velocity_terms import StandStill, TrackVelocity, TrackYawRate

EPISODE = 1000  # control steps


def velocity_terms() -> dict[str, RewardTerm]:
    """Return the terms of the reward."""
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


def _terminations() -> dict[str, Termination]:
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
        """Build the task, its robot and its graph; under :func:`velocity_terms` if ``reward`` is ``None``."""
        loaded = robot.load()
        asked = Reward(velocity_terms()) if reward is None else reward
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
        known = {reading.name for row in self.table.readings for reading in row if reading is not None}
        lacking = [axis for axis, needed in NEEDED.items() if needed not in self.facts.base]
        asked = [name for axis, name in zip(AXES, COMMANDS, strict=True) if axis not in lacking]
        return partial(self._command, asked) if known.issuperset(asked) else None

    def _command(self, asked: Sequence[str], nodes: Array) -> Array:
        xp, newest = array_namespace(nodes), nodes[..., (self.history - 1) * self.features :]
        nothing = xp.zeros_like(newest[..., 0, 0])
        shown = [newest[(..., *self.table.place(name))] if name in asked else nothing for name in COMMANDS]
        return xp.stack(shown, axis=-1)

    def command_ranges(self) -> dict[str, tuple[float, float]]:
        """Return the range of each number of the command by the name of its reading (m/s, m/s, rad/s).

        It holds 0 if some commands are to stand.
        """
        command, known = self.commands[NAME], {r.name for row in self.table.readings for r in row if r is not None}
        box = command.box
        if command.standing:
            box = np.stack([np.minimum(box[:, 0], 0.0), np.maximum(box[:, 1], 0.0)], axis=-1)
        return {name: (low, high) for name, (low, high) in zip(COMMANDS, box.tolist(), strict=True) if name in known}
