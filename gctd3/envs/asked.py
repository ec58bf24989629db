"""Settings of a task from what a caller of the Python API asks for, with the meaning that the command line has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeAlias, cast

import mujoco
from hydra import compose, initialize_config_module
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from gctd3.config.build import build
from gctd3.config.explanation import explain
from gctd3.config.help import CONF
from gctd3.config.options import options
from gctd3.errors import ConfigError, check_kind
from gctd3.robots.command_line import FREE
from gctd3.robots.floating_base import Axis
from gctd3.robots.load import floats
from gctd3.robots.robot import Robot
from gctd3.robots.settings import RobotSettings
from gctd3.robots.sources import find_place
from gctd3.tasks.reward import Reward
from gctd3.tasks.simulated_task import SimulatedTask
from gctd3.tasks.task import Task, TaskSettings, check_backend
from gctd3.tasks.terms import Termination
from gctd3.tasks.walk import WalkSettings

AnyRobot: TypeAlias = "str | Path | RobotSettings | Robot | mujoco.MjModel"
_ROOT, _KEYS = "config", ("robot", "task", "reward")  # the YAML of gctd3.train, and what is taken from it


@dataclass(frozen=True)
class InMemory(RobotSettings):
    """Hold a robot that is in memory, in the place of settings that would load one.

    Attributes:
        given: The robot.
    """

    given: Robot | None = None

    def load(self, feet: Sequence[str] | None = None) -> Robot:
        """Return the robot, read anew if other feet or another forward direction are asked for."""
        if self.given is None:
            raise ConfigError("given must be a Robot, got None.")
        asked = feet if feet is not None else self.feet
        if asked is None and self.forward is None:
            return self.given
        return Robot.from_model(
            self.given.model, self.given.path, asked, self.forward, source=self.given.source, held=self.given.held
        )


def ask(
    robot: AnyRobot = "biped",
    task: TaskSettings | str | None = None,
    reward: Reward | str | None = None,
    *,
    history: int | None = None,
    control_dt: float | None = None,
    feet: Sequence[str] | None = None,
    forward: Axis | None = None,
    terminations: Mapping[str, Termination | None] | None = None,
    overrides: Sequence[str] = (),
) -> Task:
    """Build a task as the command line would.

    Args:
        robot: What ``robot=`` of the command line takes: a robot's name (``"biped"``, ``"go2"``), an MJCF or URDF file,
            ``PACKAGE:PATH``, ``menagerie:NAME``, ``description:MODULE``, each with the settings of the task that come
            with it; or settings of a robot, a robot or a compiled model in memory, to which nothing is added.
        task: The settings of the task, or the name of an option of ``task=`` (``"velocity"``), as the robot's own
            settings change it; by default the robot's own, or else the paper's walk.
        reward: The reward, or the name of an option of ``reward=`` (``"walk"``), as the robot's own settings change it;
            by default that of the named task, or else the paper's.
        history: Number of frames stacked into an observation; the task's by default.
        control_dt: Control period (s); the task's by default.
        feet: Bodies that may touch the ground, as ``robot.feet``.
        forward: Forward direction, as ``robot.forward``.
        terminations: Terminations besides the task's, or in place of those of the same name; ``None`` leaves one out.
        overrides: Further arguments of the command line: ``["robot.hold=['*wrist*']", "task.control_dt=0.01"]``.

    Raises:
        ConfigError: If an argument is not what is expected, or does not fit the robot.
        RobotError: If the robot cannot be used.
    """
    if isinstance(robot, (str, Path)):
        named = {"task": task, "reward": reward}
        chosen = [f"{group}={name}" for group, name in named.items() if isinstance(name, str)]
        about, own, paid = _composed(str(robot), (*chosen, *overrides))
    else:
        if overrides:
            raise ConfigError(f"overrides must be empty for a robot that is no name or file, got {list(overrides)}.")
        if isinstance(reward, str):
            raise ConfigError(f"reward must be a Reward for a robot that is no name or file, got {reward!r}.")
        if isinstance(task, str):
            raise ConfigError(f"task must be TaskSettings for a robot that is no name or file, got {task!r}.")
        about, own, paid = _in_memory(robot), WalkSettings(), Reward()
    asked = own if task is None or isinstance(task, str) else task
    check_kind("task", asked, TaskSettings)
    changes: dict[str, Any] = {"history": history, "control_dt": control_dt}
    if terminations is not None:
        changes["terminations"] = {**getattr(asked, "terminations", {}), **terminations}
    given = {name: value for name, value in changes.items() if value is not None}
    if lacking := [name for name in given if not hasattr(asked, name)]:
        raise ConfigError(f"{lacking[0]} must be left out for a {type(asked).__name__}, which has none.")
    if feet is not None:
        about = replace(about, feet=feet)
    if forward is not None:
        about = replace(about, forward=forward)
    # None, and not the paper's, so that a library's task may bring its own.
    by_name = isinstance(reward, str) or (reward is None and isinstance(task, str))
    return replace(asked, **given).build(about, paid if by_name else cast("Reward | None", reward))


def ask_simulated(robot: AnyRobot | SimulatedTask, **asked: Any) -> SimulatedTask:  # noqa: ANN401 - of `ask`
    """Build a task that gctd3 simulates, see :func:`ask`; or return the one that is given.

    Raises:
        ConfigError: If another library simulates the task.
    """
    if isinstance(robot, SimulatedTask):
        if given := [name for name, value in asked.items() if value is not None]:
            raise ConfigError(f"{given[0]} must be left out for a task that is built already.")
        return robot
    task = ask(robot, **asked)
    check_backend(task, "batched")
    return cast(SimulatedTask, task)


def _in_memory(robot: object) -> RobotSettings:
    if isinstance(robot, RobotSettings):
        return robot
    if isinstance(robot, mujoco.MjModel):
        robot = Robot.from_mjcf(robot)
    if not isinstance(robot, Robot):
        raise ConfigError(f"robot must be a name, a file, RobotSettings, a Robot or an MjModel, got {robot!r}.")
    return InMemory(str(robot.path), given=robot)


@lru_cache(maxsize=32)
def _composed(robot: str, overrides: tuple[str, ...]) -> tuple[RobotSettings, TaskSettings, Reward]:
    """Return the settings of robot, task and reward that a command line composes."""
    chosen = [f"robot={robot}"]
    if file := robot not in options("robot"):
        # The path is put in afterwards: it may hold what Hydra's grammar would read as its own.
        chosen = [f"robot={FREE}"] if floats(find_place(robot).file) else []
        chosen.append("robot.name=file")
    before = GlobalHydra.instance().hydra
    GlobalHydra.instance().clear()
    try:
        with initialize_config_module(CONF, version_base="1.3"):
            config: DictConfig = compose(_ROOT, [*chosen, *overrides])
        # Together, so that messages name a key as the command line does.
        settings = build(OmegaConf.masked_copy(config, list(_KEYS)))
        about, task, reward = (settings[key] for key in _KEYS)
        return replace(about, name=robot) if file else about, task, reward
    except (HydraException, OmegaConfBaseException) as error:
        raise ConfigError(explain(error, _ROOT)) from error
    finally:
        GlobalHydra.instance().clear()
        if before is not None:
            GlobalHydra.instance().initialize(before)
