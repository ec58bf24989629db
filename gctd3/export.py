"""Export a policy, or a robot, to run elsewhere: ``python -m gctd3.export run=DIR out=policy.onnx``."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from gctd3.config.help import helped
from gctd3.files import quoted

if TYPE_CHECKING:
    from omegaconf import DictConfig


def _task(config: DictConfig) -> None:
    from omegaconf import OmegaConf

    from gctd3.config.build import build
    from gctd3.deploy.settings import ROBOTS, ExportSettings

    # A robot's YAML also holds settings of its training.
    settings: ExportSettings = build(OmegaConf.masked_copy(config, ["_target_", *ExportSettings.__dataclass_fields__]))
    if settings.out.endswith(ROBOTS):
        from gctd3.deploy.export_robot import export_robot

        print("\n".join(export_robot(settings)))
        return
    from gctd3.deploy.export import export_run

    exported = export_run(settings)
    print(f"Actions differ from PyTorch's by at most {exported.difference:.1e} over {exported.states:,} states.")
    for line in exported.warnings:
        print(f"Warning: {line}", file=sys.stderr)
    print(f"Written to {' and '.join(map(quoted, exported.files))}")


def _with_robot(arguments: list[str]) -> list[str]:
    """Return arguments for Hydra, in which a robot's file is the name of an option's robot."""
    from gctd3.robots.command_line import robot_file

    rewritten = robot_file(arguments)
    named = any(argument.startswith("robot.") for argument in rewritten)
    chosen = any(argument.startswith("robot=") for argument in rewritten)
    return ["robot=biped", *rewritten] if named and not chosen else rewritten


def main() -> None:
    """Run ``python -m gctd3.export``."""
    if not helped("export"):
        # Late, as everything that takes long: --help answers at once.
        from gctd3.config.command_line import command

        command("export", _task, _with_robot)


if __name__ == "__main__":
    main()
