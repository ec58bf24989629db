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


class NumericalError(GCTD3Error, ArithmeticError):
    """A number is NaN or infinite where it must not be."""


class RenderError(GCTD3Error, RuntimeError):
    """Nothing can be drawn here."""


def check_seed(name: str, seed: int) -> None:
    """Raise a :class:`ConfigError` unless ``seed`` fits every generator (NumPy's legacy one takes 32 bits)."""
    if not 0 <= seed < 2**32:
        raise ConfigError(f"{name} must be at least 0 and below 2^32, got {seed}.")
