"""Tasks by the options of the commands, for programs that are none: the same YAMLs, the same settings."""

from __future__ import annotations

from collections.abc import Sequence

from hydra import compose, initialize_config_module
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from gctd3.config.build import build
from gctd3.config.help import CONF
from gctd3.errors import ConfigError, one_line
from gctd3.robots.command_line import robot_file
from gctd3.tasks.task import Task


def task_of(task: str, robot: str, overrides: Sequence[str] = ()) -> Task:
    """Build a task on a robot under the training's reward, as ``python -m gctd3.train task=... robot=...`` would.

    Args:
        task: Option of the group ``task``.
        robot: Option of the group ``robot``, or what ``robot=`` of a command line takes besides: a file.
        overrides: Further settings of a command line.

    Raises:
        ConfigError: If there is no such option, or a setting is wrong.
        RobotError: If the robot cannot be used.
    """
    line = robot_file([f"task={task}", f"robot={robot}", *overrides])
    outer = GlobalHydra.instance().hydra
    GlobalHydra.instance().clear()
    try:
        with initialize_config_module(CONF, version_base="1.3"):
            config = compose("config", line)
    except (HydraException, OmegaConfBaseException) as error:
        raise ConfigError(f"{' '.join(line)}: {one_line(error)}") from error
    finally:
        GlobalHydra.instance().clear()
        if outer is not None:
            GlobalHydra.instance().initialize(outer)
    settings = build(OmegaConf.masked_copy(config, ["task", "robot", "reward"]))
    built: Task = settings["task"].build(settings["robot"], settings["reward"])
    return built
