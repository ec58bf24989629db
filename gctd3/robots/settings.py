"""Settings of the robot and of the graph over it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from gctd3.errors import check_seed

if TYPE_CHECKING:
    from gctd3.robots.graph import KinematicGraph
    from gctd3.robots.robot import Robot


@dataclass(frozen=True)
class RobotSettings:
    """Hold the settings of the robot and of the graph over it.

    Attributes:
        name: Robot that ships with gctd3, or the path of an MJCF file (robot=my.xml says the same); unused by a
            library's task, which brings its own.
        graph: Edges between its nodes: ``tree`` (the paper's), ``authors`` (the released script's), ``edgeless``,
            ``complete`` or ``random``.
        graph_seed: Seed of graph=random.
        feet: Bodies (or geoms of theirs) that may touch the ground; ``None`` for those at the ends of the legs that it
            stands on.
        forward: Forward direction among the axes of the world: x, -x, y or -y; ``None`` for that of its slide, or else
            the one for which its left and right sides are equal.
    """

    name: str = "biped"
    graph: Literal["tree", "authors", "edgeless", "complete", "random"] = "tree"
    graph_seed: int = 0
    feet: Sequence[str] | None = None
    forward: Literal["x", "-x", "y", "-y"] | None = None

    def __post_init__(self) -> None:
        check_seed("graph_seed", self.graph_seed)

    def load(self, feet: Sequence[str] | None = None) -> Robot:
        """Load the robot, with other feet if some are named.

        Raises:
            RobotError: If it cannot be used.
        """
        from gctd3.robots.robot import Robot

        return Robot.from_mjcf(self.name, self.feet if feet is None else feet, self.forward)

    def graph_of(self, robot: Robot) -> KinematicGraph:
        """Build the graph over a robot."""
        from gctd3.robots.graph import KinematicGraph

        return KinematicGraph.from_robot(robot, self.graph, self.graph_seed)
