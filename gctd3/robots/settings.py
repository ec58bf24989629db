"""Settings of the robot and of the graph over it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Literal

from gctd3.errors import ConfigError, check_seed
from gctd3.robots.servo_settings import ServoSettings

if TYPE_CHECKING:
    from gctd3.robots.graph import KinematicGraph
    from gctd3.robots.robot import Robot


@dataclass(frozen=True)
class RobotSettings:
    """Hold the settings of the robot and of the graph over it.

    Attributes:
        name: Robot that ships with gctd3; the path of an MJCF or URDF file (robot=my.xml says the same);
            ``menagerie:NAME``; ``description:MODULE``; or ``PACKAGE:PATH`` of a file of an installed package. Unused by
            a library's task, which brings its own.
        sources: Places of the robot's file, each as ``name`` would say it; the first that is installed is read, unless
            ``name`` says a place itself.
        source: The one of ``sources`` to read, or the package of one; ``None`` for the first that is installed. A run
            keeps the one that it read.
        graph: Edges between its nodes: ``tree`` (the paper's), ``authors`` (the released script's), ``edgeless``,
            ``complete`` or ``random``.
        graph_seed: Seed of graph=random.
        feet: Bodies that may touch the ground, or geoms or sites in place of bodies of which only a part may; ``None``
            for those at the ends of the legs that it stands on.
        forward: Forward direction among the axes of the world: x, -x, y or -y; ``None`` for that of its slide, or else
            the one for which its left and right sides are equal.
        root: Root body of the robot, for a file that holds several robots; ``None`` where there is one.
        pose: Key of the file in which the robot stands; ``None`` for ``stand``, ``home``, or else one that stands, or
            else a pose that is found.
        hold: Patterns (``*`` and ``?``) of joints that walking does not need: they are fixed in the standing pose.
        servos: Servos by pattern of joints, of which the first that fits counts; ``None`` leaves a pattern out.
        cone: Friction cone of contacts, MuJoCo's ``pyramidal`` or ``elliptic``; ``None`` for the file's. In pyramidal
            ones, which are MuJoCo's default, feet that stand creep.
        impratio: Stiffness of friction by that of the normal force, MuJoCo's ``impratio``: the larger, the less feet
            creep, in elliptic cones; ``None`` for the file's.
        action_scale: Change of the desired angle from the standing pose by an action of 1 (rad), one number or one by
            pattern of joints; ``range`` maps actions onto the servos' ranges (the paper's Table 2) instead. ``None``
            derives it from effort and stiffness where the base is free, and stands for ``range`` on other bases.
        least_action_scale: The least scale that is so derived (rad): with less no leg can swing.
    """

    name: str = "biped"
    graph: Literal["tree", "authors", "edgeless", "complete", "random"] = "tree"
    graph_seed: int = 0
    feet: Sequence[str] | None = None
    forward: Literal["x", "-x", "y", "-y"] | None = None
    sources: Sequence[str] = ()
    source: str | None = None
    root: str | None = None
    pose: str | None = None
    hold: Sequence[str] = ()
    servos: Mapping[str, ServoSettings | None] = field(default_factory=dict)
    cone: Literal["pyramidal", "elliptic"] | None = None
    impratio: float | None = None
    action_scale: float | str | Mapping[str, float] | None = None
    least_action_scale: float = 0.15

    def __post_init__(self) -> None:
        if self.impratio is not None and not 0 < self.impratio < math.inf:
            raise ConfigError(f"robot.impratio={self.impratio}: must be greater than 0 and finite")
        if not 0 < self.least_action_scale <= math.pi:
            raise ConfigError(
                f"least_action_scale must be above 0 and at most {math.pi:.3f} rad, got {self.least_action_scale}."
            )
        check_seed("graph_seed", self.graph_seed)

    def within(self, limits: Mapping[str, Mapping[str, float]]) -> RobotSettings:
        """Add a file's limits of single joints' servos where their patterns leave them to the file."""
        servos = dict[str, ServoSettings]()
        for joint, stated in limits.items():
            fitting = next(
                (s for pattern, s in self.given_servos.items() if fnmatchcase(joint, pattern)), ServoSettings()
            )
            servos[joint] = replace(fitting, **{key: v for key, v in stated.items() if getattr(fitting, key) is None})
        # Joints first: of the patterns that fit, the first counts.
        return replace(self, servos=servos | {key: s for key, s in self.given_servos.items() if key not in servos})

    @property
    def given_servos(self) -> dict[str, ServoSettings]:
        """Return the servos that are not left out."""
        return {pattern: servo for pattern, servo in self.servos.items() if servo is not None}

    @property
    def takes_a_source(self) -> bool:
        """Return whether one of ``sources`` is read."""
        from gctd3.robots.sources import is_place

        return bool(self.sources) and not is_place(self.name)

    def load(self, feet: Sequence[str] | None = None) -> Robot:
        """Load the robot, with other feet if some are named.

        Raises:
            RobotError: If it cannot be used.
        """
        from gctd3.robots.load import load_robot

        return load_robot(self, feet)

    def graph_of(self, robot: Robot) -> KinematicGraph:
        """Build the graph over a robot."""
        from gctd3.robots.graph import KinematicGraph

        return KinematicGraph.from_robot(robot, self.graph, self.graph_seed)


@dataclass(frozen=True)
class GivenRobot(RobotSettings):
    """Hold the settings of a robot that is given, not read.

    Attributes:
        robot: The robot.
    """

    robot: Robot | None = None

    @classmethod
    def of(cls, settings: RobotSettings, robot: Robot) -> GivenRobot:
        """Return the settings of a robot with the robot itself."""
        return cls(**{item.name: getattr(settings, item.name) for item in fields(RobotSettings)}, robot=robot)

    def load(self, feet: Sequence[str] | None = None) -> Robot:
        """Return the robot that is given, with other feet if some are named."""
        if self.robot is None:
            return super().load(feet)
        return self.robot if feet is None else replace(self.robot, feet=tuple(feet))
