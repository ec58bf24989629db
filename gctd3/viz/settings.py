"""Settings of the picture of a graph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gctd3.errors import ConfigError
from gctd3.robots.settings import RobotSettings


@dataclass(frozen=True)
class GraphSettings:
    """Hold the settings of ``gctd3.graph``.

    Attributes:
        robot: Robot and graph preset.
        feet: Bodies (or geoms of theirs) that may touch the ground, as [a,b]; ``None`` for the robot's own, or those
            that it stands on.
        out: File of the picture, ``.svg`` or ``.png``; ``None`` to print the table alone.
        size: Longer side of the robot in the picture (pixels).
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
