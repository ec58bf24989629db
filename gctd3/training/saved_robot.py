"""The setup of a run that was begun: on its own copy of its robot, whatever has become of the robot's source."""

from __future__ import annotations

import sys
from pathlib import Path

from gctd3.files import quoted
from gctd3.robots.own_copy import OwnCopy
from gctd3.setup.setup import Setup
from gctd3.training.settings import TrainSettings


def setup_of(run: Path, settings: TrainSettings) -> Setup:
    """Build the setup of a run; a line says how the robot's source differs from the run's own copy, if it does.

    A run that was made before runs kept a copy reads the robot from its source. The robot of a library's task is the
    one that its library brings.

    Raises:
        RunError: If the copy is damaged.
        RobotError: If the robot of an older run cannot be used.
        ConfigError: If a setting does not fit the robot.
    """
    copy = OwnCopy.read(run)
    if copy is not None and copy.whole:
        setup, note = settings.setup(copy.robot), copy.changes(settings.robot)
    else:
        setup = settings.setup()
        robot = setup.robot
        note = None if copy is None else copy.differences(robot, f"The robot that {setup.task.name} brings now")
        if copy is None and robot.source is not None and not robot.source.ships:
            note = f"It keeps no copy of its robot; what it is now is taken: {robot.source}."
    if note is not None:
        print(f"{quoted(run)}: {note}", file=sys.stderr, flush=True)
    return setup
