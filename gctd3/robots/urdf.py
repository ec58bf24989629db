"""Read URDF files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco

from gctd3.robots.settings import ServoSettings


@dataclass(frozen=True)
class ReadURDF:
    """Hold what a URDF says."""

    spec: mujoco.MjSpec
    notes: tuple[str, ...] = ()

    def servos(self, asked: Mapping[str, ServoSettings]) -> dict[str, ServoSettings]:
        """Return servos."""
        return dict(asked)


def is_urdf(file: Path) -> bool:
    """Tell whether a file is a URDF, by its name."""
    return file.suffix == ".urdf"


def read_urdf(file: Path) -> ReadURDF:
    """Read a URDF."""
    return ReadURDF(mujoco.MjSpec.from_file(str(file)))
