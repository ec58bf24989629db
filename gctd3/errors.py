"""What goes wrong through a user's input, each with a message fit for the command line."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping


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


class ContractError(GCTD3Error, ValueError):
    """An exported policy is missing or damaged, does not fit its contract, or is of another robot."""


class ReadingError(GCTD3Error, ValueError):
    """A policy on a robot refuses to act on what it is given.

    Attributes:
        command: What is safe to send to the servos instead: the last command, by the name of the actuator (rad).
    """

    def __init__(self, message: str, command: Mapping[str, float]) -> None:
        super().__init__(message)
        self.command = dict(command)


class WorkerError(GCTD3Error, RuntimeError):
    """Workers that collect cannot be started, or do not last."""


class RenderError(GCTD3Error, RuntimeError):
    """Nothing can be drawn here."""


class PerformanceWarning(UserWarning):
    """Something works, by a way that is slower than the one made for it."""


def suggest(key: object, known: Iterable[str]) -> str:
    """``" Did you mean ...?"`` if something like ``key`` is known, else nothing."""
    close = difflib.get_close_matches(str(key), list(known), n=1)
    return f" Did you mean {close[0]!r}?" if close else ""


def check_between(settings: object, least: float, most: float, *names: str) -> None:
    """Raise a :class:`ConfigError` unless each attribute of ``names`` is ``None`` or in ``[least, most]``."""
    for name in names:
        value = getattr(settings, name)
        if value is not None and not value >= least:
            raise ConfigError(f"{name} must be at least {least:,}, got {value}.")
        if value is not None and not value <= most:
            raise ConfigError(f"{name} must be at most {most:,}, got {value}.")


def check_seed(name: str, seed: int) -> None:
    """Raise a :class:`ConfigError` unless ``seed`` fits every generator (NumPy's legacy one takes 32 bits)."""
    if not 0 <= seed < 2**32:
        raise ConfigError(f"{name} must be at least 0 and below 2^32, got {seed}.")
