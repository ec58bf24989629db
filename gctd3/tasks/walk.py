"""The paper's task: walk forward as far as the finish."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from gctd3.robots.graph import KinematicGraph
from gctd3.robots.robot import Robot
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.features import paper_features
from gctd3.tasks.randomisations import JointNoise
from gctd3.tasks.reward import Reward
from gctd3.tasks.simulated_task import Composition, SimulatedTask
from gctd3.tasks.terminations import Fall, Finish, LongContact, StuckHip, TimeLimit
from gctd3.tasks.terms import Randomisation, Termination


def paper_terminations() -> dict[str, Termination]:
    """Return the terminations of the paper's episodes.

    The finish and the time limit truncate an episode (its value is bootstrapped), all others terminate it.
    """
    return {
        "fall": Fall(),
        # Table 3 names the rule, the released script the number.
        "long_contact": LongContact(),
        # Released script only.
        "stuck_hip": StuckHip(),
        # Section 3.2.
        "finish": Finish(),
        "time_limit": TimeLimit(),
    }


def paper_randomisations() -> dict[str, Randomisation]:
    """Return the randomisations of the start of the paper's episodes."""
    return {"joint_noise": JointNoise()}


@dataclass(frozen=True)
class WalkSettings(Composition):
    """Hold the settings of the paper's task, to walk forward to the finish; see :class:`.Composition`.

    Attributes:
        features: Features of the paper (section 2.3), and those of bases without a boom.
        terminations: Terminations of the paper.
        randomisations: Randomisations of the start: noise on every joint.
    """

    features: Mapping[str, Any] = field(default_factory=paper_features)
    terminations: Mapping[str, Any] = field(default_factory=paper_terminations)
    randomisations: Mapping[str, Any] = field(default_factory=paper_randomisations)

    def build(self, robot: RobotSettings, reward: Reward | None = None) -> WalkingTask:
        """Build the task, its robot and its graph; under the paper's reward if ``reward`` is ``None``."""
        loaded = robot.load()
        return WalkingTask(loaded, reward, self, robot.graph_of(loaded))


class WalkingTask(SimulatedTask):
    """Define the walking task of the paper on a robot; see :class:`.SimulatedTask`.

    Args:
        robot: The robot.
        reward: The reward; the paper's if ``None``.
        settings: The other terms of the task; the paper's if ``None``.
        graph: The robot's graph; its tree if ``None``.
    """

    name = "walk"

    def __init__(
        self,
        robot: Robot,
        reward: Reward | None = None,
        settings: Composition | None = None,
        graph: KinematicGraph | None = None,
    ) -> None:
        asked, composed = Reward() if reward is None else reward, WalkSettings() if settings is None else settings
        super().__init__(robot, asked, composed, graph)
