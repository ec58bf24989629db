"""A task of one's own: hold the body at a height that is commanded, and changes from time to time.

Train with it:

    PYTHONPATH=examples/extending/whole_task python -m gctd3.train \
        --config-dir=examples/extending/whole_task task=crouch
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from gctd3.robots.robot import Robot
from gctd3.tasks.commands import UniformCommand
from gctd3.tasks.features import NodeFeature, Reading, Sensed, paper_features
from gctd3.tasks.memory import COMMAND
from gctd3.tasks.randomisations import JointNoise
from gctd3.tasks.simulated_task import Composition
from gctd3.tasks.terminations import Fall, TimeLimit
from gctd3.tasks.terms import Array, RewardTerm, Step

HEIGHT = f"{COMMAND}height"


@dataclass(frozen=True)
class TrackHeight(RewardTerm):
    """Pay for the body's height being near the commanded one.

    Attributes:
        scale: Distance at which the pay has fallen to ``1 / e`` (m).
    """

    scale: float = 0.02

    def __call__(self, step: Step) -> Array:
        """Return ``weight * exp(-(height - command)^2 / scale^2)``, shape ``[*]``."""
        # The command that was seen when the action was chosen.
        off = (step.now.height - step.before[HEIGHT][..., 0]) / self.scale
        return self.weight * step.xp.exp(-(off**2))


@dataclass(frozen=True)
class HeightCommand(NodeFeature):
    """Sense the commanded height at the root."""

    kind: ClassVar[str] = "root"

    def readings(self, robot: Robot, nodes: tuple[str, ...]) -> list[list[Reading | None]]:
        """Return the command."""
        return [[Reading("command_height_m", "height that the body is to have, from standing", "command")]]

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return the command, shape ``[*, 1, 1]``."""
        return sensed.memory[HEIGHT][..., None]


def _features() -> dict[str, NodeFeature]:
    return {**paper_features(), "command": HeightCommand()}


@dataclass(frozen=True)
class CrouchSettings(Composition):
    """Hold the body at a commanded height; see :class:`gctd3.tasks.simulated_task.Composition`."""

    features: Mapping[str, Any] = field(default_factory=_features)
    terminations: Mapping[str, Any] = field(default_factory=lambda: {"fall": Fall(), "time_limit": TimeLimit(500)})
    randomisations: Mapping[str, Any] = field(default_factory=lambda: {"joint_noise": JointNoise()})
    commands: Mapping[str, Any] = field(
        default_factory=lambda: {"height": UniformCommand(every=2.0, low=(-0.08,), high=(0.0,))}
    )
