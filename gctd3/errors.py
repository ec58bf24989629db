"""Errors caused by a user's input, each with a message fit for the command line."""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Iterable, Mapping


class GCTD3Error(Exception):
    """Group the library's errors under one base class."""


class RobotError(GCTD3Error, ValueError):
    """Report that an MJCF file cannot be used as a robot."""


class ConfigError(GCTD3Error, ValueError):
    """Report that a setting is unknown, of the wrong type or out of range."""


class TermError(GCTD3Error, RuntimeError):
    """Report that a term of a task raised an error, which is the cause of this one."""


class RunError(GCTD3Error, ValueError):
    """Report that a run directory or checkpoint is missing, incomplete or of another version."""


class NumericalError(GCTD3Error, ArithmeticError):
    """Report that a number is NaN or infinite where it must be finite."""


class ContractError(GCTD3Error, ValueError):
    """Report that an exported policy is missing or damaged, does not fit its contract, or belongs to another robot."""


class ReadingError(GCTD3Error, ValueError):
    """Report that a policy on a robot refuses to act on its sensor readings or its network's output.

    Attributes:
        command: Safe command for the servos instead, by the name of the actuator (rad): the last good command for some
            control periods, then the way to the home pose; see :class:`.Safety`.
    """

    def __init__(self, message: str, command: Mapping[str, float]) -> None:
        super().__init__(message)
        self.command = dict(command)


class TrainingError(GCTD3Error, RuntimeError):
    """Report that a training cannot succeed, and why."""


class WorkerError(GCTD3Error, RuntimeError):
    """Report that workers which collect transitions cannot be started or do not keep running."""


class MiddlewareError(GCTD3Error, RuntimeError):
    """Report that ROS is missing, its master or the other node cannot be reached, or a node has fallen silent."""


class EngineError(GCTD3Error, RuntimeError):
    """Report that another physics engine cannot be compiled or started, or has ended."""


class RenderError(GCTD3Error, RuntimeError):
    """Report that images or videos cannot be rendered."""


class PackageError(GCTD3Error, ImportError):
    """Report that a package which something needs is missing, or cannot be imported."""


class PerformanceWarning(UserWarning):
    """Warn that a computation works, but by a slower way than the one made for it."""


def one_line(error: Exception) -> str:
    """Return an error's message as one line without a full stop: MuJoCo's have several."""
    return " ".join(str(error).split()).rstrip(".")


def shown(value: object) -> str:
    """Return ``repr(value)``, shortened to a line; the name of the type where there is none."""
    try:
        text = reprlib.repr(value) if isinstance(value, (str, bytes, int, list, tuple, dict, set)) else repr(value)
        text = " ".join(text.split())
    except Exception:  # whatever the object's own code raises
        return type(value).__name__
    return text if len(text) <= 80 else f"{text[:77]}..."


def suggest(key: object, known: Iterable[str]) -> str:
    """Return ``" Did you mean ...?"`` if a name similar to ``key`` is known, else an empty string."""
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


def check_kind(name: str, given: object, kind: type) -> None:
    """Raise a :class:`ConfigError` unless ``given`` is an object of a class."""
    if not isinstance(given, kind):
        raise ConfigError(f"{name} must be a {kind.__name__}, got {given!r}.")


def check_seed(name: str, seed: int) -> None:
    """Raise a :class:`ConfigError` unless ``seed`` fits every generator (NumPy's legacy one takes 32 bits)."""
    if not 0 <= seed < 2**32:
        raise ConfigError(f"{name} must be at least 0 and below 2^32, got {seed}.")
