"""What policies and critics observe of a simulated task."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from gctd3.errors import RobotError
from gctd3.robots.array_library import array_namespace
from gctd3.robots.mirror_check import check_mirror
from gctd3.robots.robot import Robot
from gctd3.tasks.domain_randomisation import NOISE
from gctd3.tasks.feature_table import FeatureTable
from gctd3.tasks.features import Sensed
from gctd3.tasks.measurement import Measurement
from gctd3.tasks.memory import Memory
from gctd3.tasks.posture import Posture
from gctd3.tasks.reflection import Reflection
from gctd3.tasks.sensor_noise import OWN_NOISE
from gctd3.tasks.term_checks import called
from gctd3.tasks.terminations import STEPS
from gctd3.tasks.terms import Array, RobotFacts


class TaskObservations:
    """Define what policies and critics observe of a task; see :class:`.SimulatedTask`, which composes it.

    Attributes:
        robot: The robot.
        facts: Its facts.
        control_dt: Control period (s).
        history: Number of frames stacked into an observation.
        table: Features of the nodes.
        features: Number of features of a node in a frame.
        privileged: Features of the nodes that only critics observe; ``None`` for none.
        terminations: Terminations by name, whose clocks critics observe.
        time_limit: Time limit of an episode (control steps).
    """

    robot: Robot
    facts: RobotFacts
    control_dt: float
    history: int
    table: FeatureTable
    features: int
    privileged: FeatureTable | None
    terminations: dict[str, Any]
    time_limit: int

    def node_features(self, now: Measurement, memory: Memory | None = None) -> np.ndarray:
        """Return the features of every node in one frame, ``float32 [*, N, F]``; see :class:`.FeatureTable`."""
        nodes = self.table(Sensed(now, memory or {}, self.facts))
        for noise in (NOISE, OWN_NOISE):
            if memory is not None and noise in memory:
                nodes = nodes + memory[noise]
        return nodes

    @property
    def shown_command(self) -> Callable[[Array], Array] | None:
        """Return a function that reads what is commanded, a velocity or a height; ``None`` for a task without commands.

        It takes observations of the nodes, ``[*, N, F * H]``, of NumPy or PyTorch, and returns the numbers of the
        command, ``[*, C]``; a subclass says their units.
        """
        return None

    @property
    def shown_velocity(self) -> Callable[[Array], Array] | None:
        """Return a function that reads how a robot moves from counters; ``None`` for a task without commands."""
        return None

    @property
    def levels(self) -> tuple[float, ...] | None:
        """Return the commanded heights of jumps, rising (m); ``None`` for a task without them."""
        return None

    @functools.cached_property
    def posture(self) -> Posture:
        """Return what shows the body's posture in observations."""
        return Posture(self.table, self.history, self.robot.leg_length)

    def phase(self, nodes: Array) -> Array:
        """Return the phase that a task with a clock shows in observations, in periods from an episode's start.

        Args:
            nodes: Observations of the nodes, ``[*, N, F * H]``, of NumPy or PyTorch.

        Returns:
            Phases, ``[*]``.
        """
        xp, foot = array_namespace(nodes), self.robot.feet[0]
        newest = nodes[..., (self.history - 1) * self.features :]
        sine, cosine = (newest[(..., *self.table.place(f"{wave}_{foot}"))] for wave in ("clock_sin", "clock_cos"))
        return xp.atan2(sine, cosine) / (2 * math.pi) - float(self.facts.foot_phases[0])

    def counters(self, memory: Memory, now: Measurement | None = None) -> np.ndarray:
        """Return what only critics observe, ``float32 [*, K]``.

        It is the progress to each time-based termination, and the numbers of the privileged features.

        Args:
            memory: The memory.
            now: The measurement; a task without privileged features needs none.

        Raises:
            ValueError: If there are privileged features, and no measurement.
        """
        parts = [
            called(f"task.terminations.{name}", term.clock, memory, self.facts, self.time_limit)
            for name, term in self.terminations.items()
        ]
        shown = [part for part in parts if part is not None]
        if self.privileged is not None:
            if now is None:
                raise ValueError("Privileged features are measured: counters needs the measurement.")
            shown.append(self.privileged.flat(Sensed(now, memory, self.facts)))
        if not shown:
            return np.zeros((*memory[STEPS].shape, 0), dtype=np.float32)
        return np.concatenate(shown, axis=-1).astype(np.float32)

    def reflection(self) -> Reflection:
        """Return the reflection of observations, actions and counters.

        Raises:
            RobotError: If the robot is not the same on its left and its right, see :func:`.check_mirror`.
        """
        mirrors = [term.clock_mirror(self.facts) for term in self.terminations.values()]
        mirrors += [] if self.privileged is None else [self.privileged.flat_reflection()]
        reflection, verdict = Reflection.of(self.robot, self.table, mirrors), check_mirror(self.robot, self.control_dt)
        if not verdict.symmetric:
            raise RobotError(
                f"{self.robot.path} does not move alike on its left and its right. Set replay.mirror=false, and "
                f"network.equivariant=false if that is on; or mend {verdict.reason}."
            )
        return reflection

    def command_ranges(self) -> dict[str, tuple[float, float]]:
        """Return the range of each number of the commands by the name of its reading; empty for a task without."""
        return {}

    def command_slew_rates(self) -> dict[str, float]:
        """Return the largest change a second of each number of the commands by its reading; of those that jump none."""
        return {}
