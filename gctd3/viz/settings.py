"""Settings of the picture of a graph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gctd3.errors import ConfigError
from gctd3.robots.settings import RobotSettings


@dataclass(frozen=True)
class GraphSettings:
    """What ``gctd3.graph`` is asked to draw.

    Attributes:
        robot: Which robot and preset.
        feet: In place of the robot's own, if not ``None``.
        out: ``.svg`` or ``.png``; ``None`` for the table alone.
        size: Of the robot's picture, its longer side (pixels).
    """

    robot: RobotSettings
    feet: Sequence[str] | None = None
    out: str | None = "graph.svg"
    size: int = 720

    def __post_init__(self) -> None:
        if self.size < 100:
            raise ConfigError(f"size must be at least 100, got {self.size}.")
        if self.out is None:
            return
        if Path(self.out).suffix not in (".svg", ".png"):
            raise ConfigError(f"out must end in .svg or .png, or be null, got {self.out!r}.")
        folder = Path(self.out).absolute().parent
        if not folder.is_dir():
            raise ConfigError(f"out={self.out}: there is no folder {folder}.")
