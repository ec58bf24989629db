"""Load the robot that settings ask for: find its file, read it, complete it.

Library code that has a model in memory builds a :class:`.Robot` from it directly, and completes nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from gctd3.errors import RobotError, one_line
from gctd3.robots.action_scale import find_action_scale
from gctd3.robots.blueprint import Blueprint
from gctd3.robots.completion import complete
from gctd3.robots.held_pose import holds
from gctd3.robots.portable import Written
from gctd3.robots.robot import Robot
from gctd3.robots.sources import Source, find_source
from gctd3.robots.stand_trial import FALLS
from gctd3.robots.standing_command import find_standing_command
from gctd3.robots.urdf import is_urdf, read_urdf

if TYPE_CHECKING:
    from gctd3.robots.settings import RobotSettings

LEAST_CHANGE = 0.01  # rad of a desired angle that is worth a note


def load_robot(settings: RobotSettings, feet: Sequence[str] | None = None) -> Robot:
    """Load the robot that settings ask for, with other feet if some are named.

    Raises:
        RobotError: If there is no such file, it cannot be read, or it is no robot.
    """
    source = find_source(settings)
    spec, settings, notes = read_spec(source, settings)
    if feet is not None:
        settings = replace(settings, feet=feet)
    completed = complete(spec, source.file, settings)
    robot = Robot.from_model(
        completed.model,
        source.file,
        completed.feet,
        settings.forward,
        root_name=completed.root,
        driven=True,
        source=source,
        notes=(*notes, *completed.notes),
        held=completed.held,
    )
    written = Written(completed.spec, completed.model, source.file.parent)
    robot = replace(robot, written=written, blueprint=Blueprint(completed.spec.copy))
    scale = find_action_scale(robot, settings.action_scale, settings.least_action_scale)
    return robot if scale is None else _about_standing(replace(robot, action_scale=scale))


def _about_standing(robot: Robot) -> Robot:
    """Let an action of 0 carry the robot's weight, and say whether it then stands."""
    pose = robot.action_map[0]
    command = find_standing_command(robot)
    notes = [note for note in robot.notes if not note.startswith(FALLS)]
    more = float(np.abs(command - pose).max(initial=0.0))
    if robot.notes and more > LEAST_CHANGE:
        notes.append(f"An action of 0 asks for up to {more:.2g} rad more than the standing pose, to carry the weight.")
    if robot.notes:  # of a file that was completed
        held = holds(robot.model, robot.standing_qpos, robot.base.root, command=command)
        if held.fell is not None:
            notes.append(f"{FALLS} {held.fell:.2g} s.")
    return replace(robot, standing_command=tuple(command.tolist()), notes=tuple(notes))


def read_spec(source: Source, settings: RobotSettings) -> tuple[mujoco.MjSpec, RobotSettings, tuple[str, ...]]:
    """Read a robot's file without compiling it.

    Returns:
        The file's content; the settings, with the limits of its servos that MuJoCo has no place for; and notes on
        changes that were made to read it.

    Raises:
        RobotError: If it cannot be read.
    """
    if is_urdf(source.file):
        read = read_urdf(source.file)
        return read.spec, settings.within(read.limits), read.notes
    return parse_mjcf(source.file), settings, ()


def floats(file: Path) -> bool:
    """Tell whether the robot of a file has a free base, without compiling it; of a file that is damaged ``False``."""
    if is_urdf(file):
        return True
    try:
        spec = parse_mjcf(file)
    except RobotError:
        return False  # its loading reports the error

    def floating(body: mujoco.MjsBody) -> bool:
        return any(int(joint.type) == mujoco.mjtJoint.mjJNT_FREE for joint in body.joints)

    # A body with a free joint and nothing else, such as a ball, is scenery.
    return any(floating(body) and len(body.find_all("joint")) > 1 for body in spec.worldbody.bodies)


def parse_mjcf(file: Path) -> mujoco.MjSpec:
    """Parse an MJCF file, without compiling it.

    Raises:
        RobotError: If it is not one.
    """
    try:
        return mujoco.MjSpec.from_file(str(file))
    except UnicodeDecodeError as error:
        raise RobotError(f"{file} has a name that is not UTF-8: {error}") from error
    except ValueError as error:
        raise RobotError(f"{file} is not an MJCF that MuJoCo can compile: {one_line(error)}") from error
