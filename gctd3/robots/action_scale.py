"""The scale of actions about the standing pose: how far an action of 1 moves each desired angle."""

from __future__ import annotations

from collections.abc import Mapping
from fnmatch import fnmatchcase

import numpy as np

from gctd3.errors import ConfigError, suggest
from gctd3.robots.actuators import torque_limit
from gctd3.robots.robot import Robot

MOST = 0.5  # rad, of a scale that is derived


def find_action_scale(
    robot: Robot, asked: float | str | Mapping[str, float] | None, least: float
) -> tuple[float, ...] | None:
    """Find the scale of each action (rad); ``None`` for actions that are mapped onto the servos' ranges.

    A derived scale is the largest torque over the stiffness, the change of the desired angle that uses the whole
    torque, of 0.5 rad at most. mjlab (1.6) takes a quarter of that for its softer servos.

    Args:
        robot: The robot.
        asked: See ``action_scale`` of :class:`.RobotSettings`.
        least: The least scale that is derived (rad).

    Raises:
        ConfigError: If a scale is not above 0, a pattern fits no joint, or a joint has no scale.
    """
    if isinstance(asked, str):
        if asked != "range":
            raise ConfigError(f"robot.action_scale must be range, a number, a mapping or null, got {asked!r}.")
        return None
    if asked is None:
        free = robot.base.kind == "free"
        return tuple(_derived(robot, i, least) for i in range(len(robot.actuated))) if free else None
    patterns = dict(asked) if isinstance(asked, Mapping) else {"*": asked}
    for pattern, scale in patterns.items():
        if not scale > 0:
            raise ConfigError(f"robot.action_scale must be above 0 rad, got {scale} for {pattern!r}.")
        if not any(fnmatchcase(name, pattern) for name in robot.actuated):
            raise ConfigError(
                f"robot.action_scale: {pattern!r} fits no driven joint.{suggest(pattern, robot.actuated)} "
                f"Joints: {', '.join(robot.actuated)}."
            )
    scales = []
    for name in robot.actuated:
        fitting = [scale for pattern, scale in patterns.items() if fnmatchcase(name, pattern)]
        if not fitting:
            raise ConfigError(f"robot.action_scale gives no scale for joint {name!r}; add '*' for all others.")
        scales.append(float(fitting[0]))
    return tuple(scales)


def _derived(robot: Robot, index: int, least: float) -> float:
    stiffness, effort = float(robot.model.actuator_gainprm[index, 0]), torque_limit(robot, index)
    uses = effort / stiffness if np.isfinite(effort) and stiffness > 0 else MOST
    return float(max(least, min(uses, MOST)))
