"""Objects that a training derives from its settings before its first step: built once, and handed on."""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING, Literal

from gctd3.errors import ConfigError
from gctd3.robots.graph import KinematicGraph
from gctd3.robots.mirror_check import MirrorCheck, check_mirror
from gctd3.robots.robot import Robot
from gctd3.tasks.reflection import Reflection
from gctd3.tasks.task import Task

if TYPE_CHECKING:
    import torch

    from gctd3.algorithms.base import Architecture
    from gctd3.nn.settings import NetworkSettings


class Setup:
    """Hold a task on a robot, and the settings of the networks that go with it.

    Args:
        task: The task; it holds the robot and the graph.
        network: Kind and sizes of the networks.
        privileged_critic: Whether the critics observe how near each time-based termination is.

    Raises:
        ConfigError: If the networks do not fit the task's observation.
    """

    def __init__(self, task: Task, network: NetworkSettings, privileged_critic: bool) -> None:
        self.task, self.network = task, network
        self._privileged = task.num_counters if privileged_critic else 0
        if network.knows_graph and not task.graph.kinds:
            raise ConfigError(
                "task.observation must be nodes for a network that knows the robot's graph, got flat: use network=mlp."
            )

    @property
    def robot(self) -> Robot:
        """Return the robot."""
        return self.task.robot

    @property
    def graph(self) -> KinematicGraph:
        """Return the graph of the observation."""
        return self.task.graph

    @cached_property
    def reflection(self) -> Reflection:
        """Return the reflection of observations and actions in the mirror.

        Raises:
            ConfigError: If the task has no mirror image.
            RobotError: If the robot is not the same on its left and its right.
        """
        return self.task.reflection()

    @cached_property
    def mirror_check(self) -> MirrorCheck:
        """Return whether the robot may be mirrored, and why."""
        if "mirror" not in self.task.abilities:
            return MirrorCheck(False, math.nan, f"{self.task.name}: the mirror is for simulated tasks")
        return check_mirror(self.robot, self.task.control_dt)

    def mirrors(self, asked: Literal["auto"] | bool) -> bool:
        """Decide whether batches are mirrored.

        Args:
            asked: ``mirror`` of :class:`.ReplaySettings`.

        Raises:
            RobotError: If it is asked for, and the robot is not the same on its left and its right.
        """
        if asked is True:
            _ = self.reflection
        return self.mirror_check.symmetric if asked == "auto" else bool(asked)

    def architecture(self, device: torch.device | str = "cpu") -> Architecture:
        """Return the architecture from which networks are built on ``device``."""
        from gctd3.algorithms.base import Architecture  # late: it needs PyTorch

        return Architecture(
            graph=self.graph,
            network=self.network,
            in_features=self.task.features * self.task.history,
            action_dim=int(self.robot.model.nu),
            privileged_dim=self._privileged,
            reflection=self.reflection if self.network.equivariant else None,
            device=device,
        )
