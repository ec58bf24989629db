"""Export a robot to run elsewhere: ``python -m gctd3.export robot=go2 out=go2.urdf``."""

from __future__ import annotations

from pathlib import Path

from gctd3.deploy.settings import ExportSettings
from gctd3.files import check_writable, quoted
from gctd3.robots.description import describe_robot
from gctd3.runs.load import load_run


def export_robot(settings: ExportSettings) -> list[str]:
    """Write the robot of a run, or one without a run, as URDF or SDF.

    Returns:
        Lines to print: where the robot comes from, what the format cannot say, and the files.

    Raises:
        RunError: If the directory is not a run, or the file cannot be written.
        RobotError: If the robot cannot be used, or has a ball joint.
    """
    file = Path(settings.out)
    check_writable(file)
    robot = load_run(settings.run).setup.task.robot if settings.robot is None else settings.robot.load()
    description = describe_robot(robot, "urdf" if file.suffix == ".urdf" else "sdf", file.stem)
    files = description.write(file)
    meshes = f" and {len(files) - 1} meshes beside it" if len(files) > 1 else ""
    lines = [robot.origin] if robot.origin else []
    return [
        *lines,
        f"{file.suffix[1:].upper()} cannot say, or says otherwise:",
        *(f"  {sentence}" for sentence in description.unsaid),
        f"Written to {quoted(file)}{meshes}",
    ]
