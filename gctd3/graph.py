"""Show the kinematic graph of a robot: ``python -m gctd3.graph robot=my.xml out=graph.svg``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gctd3.config.help import helped
from gctd3.robots.command_line import robot_file

if TYPE_CHECKING:
    from omegaconf import DictConfig


def _task(config: DictConfig) -> None:
    from gctd3.viz.graph_drawing import show_graph

    show_graph(config)


def main() -> None:
    """Run ``python -m gctd3.graph``."""
    if not helped("graph"):
        # Late, as everything that takes long: --help answers at once.
        from gctd3.config.command_line import command

        command("graph", _task, robot_file)


if __name__ == "__main__":
    main()
