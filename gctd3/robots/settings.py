"""Settings of the robot: which one, and which graph over it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from gctd3.errors import check_seed

if TYPE_CHECKING:
    from gctd3.robots.robot import Robot


@dataclass(frozen=True)
class RobotSettings:
    """Which robot, and which graph over it.

    Attributes:
        name: A shipped robot, or the path of an MJCF file; of no meaning for a library's task, which brings its own.
        graph: Preset of :meth:`gctd3.KinematicGraph.from_robot`.
        graph_seed: For ``graph=random``.
        feet: Names of the bodies that may touch the ground; ``None`` for those that stand on it.
        forward: Where the robot is to go, of the world's axes; ``None`` to find out.
    """

    name: str = "biped"
    graph: Literal["tree", "authors", "edgeless", "complete", "random"] = "tree"
    graph_seed: int = 0
    feet: Sequence[str] | None = None
    forward: Literal["x", "-x", "y", "-y"] | None = None

    def __post_init__(self) -> None:
        check_seed("graph_seed", self.graph_seed)

    def load(self, feet: Sequence[str] | None = None) -> Robot:
        """The robot, with other feet if some are named.

        Raises:
            RobotError: If it cannot be used.
        """
        from gctd3.robots.robot import Robot

        return Robot.from_mjcf(self.name, self.feet if feet is None else feet, self.forward)
