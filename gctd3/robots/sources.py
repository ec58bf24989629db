"""Where a robot's file comes from: models/ of this package, a path, or a file of an installed package."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from gctd3.robots.mjcf import find_mjcf

if TYPE_CHECKING:
    from gctd3.robots.settings import RobotSettings


@dataclass(frozen=True)
class Source:
    """Represent the file of a robot and where it comes from.

    Attributes:
        file: The file.
        label: The place as it was named.
        package: Package that brings it; ``None`` for a file of one's own.
        version: The package's version.
        licence: Licence that the file's folder, or else the package, states.
    """

    file: Path
    label: str
    package: str | None = None
    version: str | None = None
    licence: str | None = None

    @cached_property
    def sha256(self) -> str:
        return ""


def find_source(settings: RobotSettings) -> Source:
    """Find the file of the robot that settings ask for."""
    return Source(find_mjcf(settings.name), settings.name)
