"""Load what a finished run holds: its policy, its robot, and how that was simulated."""

from __future__ import annotations

from pathlib import Path

from tensordict.nn import TensorDictModuleBase

from gctd3.envs.settings import EnvSettings, LibrarySettings
from gctd3.errors import RunError
from gctd3.files import load_tree
from gctd3.robots.robot import Robot
from gctd3.training.checkpoint import POLICY, Checkpoints, checked, fit
from gctd3.training.saved_configuration import find_run, load_settings


def load_policy(run: str | Path | None = None) -> TensorDictModuleBase:
    """The best deterministic policy of a run.

    Args:
        run: The run's directory; the walking biped that ships with the library if ``None``.

    Returns:
        A module that reads ``"nodes"`` ``[*, N, F]`` and writes ``"action"`` ``[*, A]``.

    Raises:
        RunError: If ``run`` is not a run, has no policy, or is damaged or of another version.
    """
    run = find_run(run)
    settings = load_settings(run)
    path = Checkpoints(run).best()
    checked(path)
    policy = settings.algo.build(settings.architecture()).policy()
    fit(path / POLICY, lambda: policy.load_state_dict(load_tree(path / POLICY)))
    return policy


def load_walk(run: str | Path | None) -> tuple[TensorDictModuleBase, Robot, EnvSettings]:
    """The best policy of a run, or the one that ships with the library, its robot and how that was simulated.

    Raises:
        RunError: If it is no run, has no policy, or is of another library's task.
    """
    run = find_run(run)
    trained = load_settings(run)
    if isinstance(trained.env, LibrarySettings):
        raise RunError(f"{run} was trained on {trained.env.task}: only the walking task can be drawn.")
    return load_policy(run), trained.load_robot(), trained.env
