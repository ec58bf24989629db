"""What goes wrong through a user's input, each with a message fit for the command line."""

from __future__ import annotations


class GCTD3Error(Exception):
    """Base of the library's errors."""


class RobotError(GCTD3Error, ValueError):
    """An MJCF file cannot be used as a robot."""


class ConfigError(GCTD3Error, ValueError):
    """A setting is unknown, of the wrong type or out of range."""


class RunError(GCTD3Error, ValueError):
    """A run directory or checkpoint is missing, incomplete or of another version."""


class RenderError(GCTD3Error, RuntimeError):
    """Nothing can be drawn here."""
