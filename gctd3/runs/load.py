"""Load a finished run: its policy, and the task for which that was trained."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tensordict.nn import TensorDictModuleBase

from gctd3.files import load_tree
from gctd3.robots.own_copy import OwnCopy
from gctd3.setup.setup import Setup
from gctd3.tasks.reward import Reward
from gctd3.tasks.task import Ability, check_able
from gctd3.training.checkpoint import POLICY, Checkpoints, checked, fit
from gctd3.training.saved_configuration import find_run, load_settings
from gctd3.training.saved_robot import setup_of
from gctd3.training.settings import TrainSettings


@dataclass(frozen=True)
class LoadedRun:
    """Hold the settings and setup of a run, read once.

    Attributes:
        directory: Directory of the run.
        settings: Settings with which it was started.
        setup: Its robot, task and the shape of its networks.
    """

    directory: Path
    settings: TrainSettings
    setup: Setup

    def policy(self) -> TensorDictModuleBase:
        """Load its best deterministic policy; see :func:`load_policy`."""
        path = Checkpoints(self.directory).best()
        checked(path)
        policy = self.settings.algo.build(self.setup.architecture()).policy()
        fit(path / POLICY, lambda: policy.load_state_dict(load_tree(path / POLICY)))
        return policy

    def task(self, ability: Ability, reward: Reward | None = None) -> Any:  # noqa: ANN401 - a task with that ability
        """Return its task under a reward, by default the one under which training evaluated.

        Raises:
            RunError: If the task does not have the ability.
        """
        check_able(self.setup.task, ability, self.directory)
        task: Any = self.setup.task.evaluated(reward or self.settings.evaluation.reward)
        copy = OwnCopy.read(self.directory) if ability == "film" else None
        # The copy has no visual meshes.
        return task if copy is None else task.on(copy.drawn(self.setup.robot, self.settings.robot))


def load_run(run: str | Path | None = None) -> LoadedRun:
    """Load the settings and setup of a run.

    Args:
        run: Its directory; the walking biped that ships with the library if ``None``.

    Raises:
        RunError: If it is not a run, or one of another version.
        RobotError: If its robot cannot be used.
    """
    directory = find_run(run)
    settings = load_settings(directory)
    return LoadedRun(directory, settings, setup_of(directory, settings))


def load_policy(run: str | Path | None = None) -> TensorDictModuleBase:
    """Load the best deterministic policy of a run.

    Args:
        run: The run's directory; the walking biped that ships with the library if ``None``.

    Returns:
        A module that reads ``"nodes"`` ``[*, N, F]`` and writes ``"action"`` ``[*, A]``.

    Raises:
        RunError: If ``run`` is not a run, has no policy, or is damaged or of another version.
    """
    return load_run(run).policy()
