"""Sensors of real robots that give the readings of a policy; needs the standard library only."""

from __future__ import annotations

from typing import Literal, get_args

# ``foot contact switch``: a switch, or a contact estimated from torques. ``simulator``: a quantity that no sensor of a
# robot which walks freely measures, such as its exact height, heading, place and speed; ``boom encoder``: on a boom,
# encoders in the boom's joints measure them. ``last action`` and ``clock``: no sensor, the policy itself. ``nothing``:
# always 0.
Source = Literal[
    "joint encoder",
    "IMU gyroscope",
    "IMU orientation",
    "foot contact switch",
    "state estimator",
    "height map",
    "command",
    "last action",
    "clock",
    "boom encoder",
    "simulator",
    "not stated",
    "nothing",
]
SOURCES: tuple[str, ...] = get_args(Source)
EXACT: tuple[Source, ...] = ("boom encoder", "simulator")  # of these a robot that walks freely has none
