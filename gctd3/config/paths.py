"""Paths on a command line: any that the file system takes, whatever Hydra's grammar would read in them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

RUN_DIRECTORIES = ("hydra.run.dir", "hydra.sweep.dir")  # which may hold interpolations
KEYS = ("run", "resume", "runs", "out", "init", "robot.name", *RUN_DIRECTORIES)
_NULL = ("", "null")
_SWEEPS = ("-m", "--multirun", "hydra.mode=MULTIRUN")
_PLAIN = re.compile(r"[A-Za-z0-9_./-]*/[A-Za-z0-9_./-]*")  # what Hydra reads as a text as it is
_ESCAPED = re.compile(r"\\([\\()\[\]{}:=, \t])")
_QUOTED = re.compile(r"'(?:[^'\\]|\\.)*'|\"(?:[^\"\\]|\\.)*\"", re.DOTALL)


def literal_paths(arguments: Sequence[str]) -> list[str]:
    """Write the paths among arguments in quotes for Hydra; those that are quoted already stay as they are.

    In a sweep a comma separates several values, unless there is a file or a directory of that very name.
    """
    sweeping = sweeps(arguments)
    return [_literal(argument, sweeping) for argument in arguments]


def sweeps(arguments: Sequence[str]) -> bool:
    """Tell whether arguments ask for a sweep."""
    return any(argument in _SWEEPS for argument in arguments)


def exists(value: str) -> bool:
    """Tell whether there is a file or a directory of this name."""
    try:
        return Path(value).exists()
    except (OSError, ValueError):  # too long, or with a character that no name has
        return False


def _literal(argument: str, sweeping: bool) -> str:
    name, assigned, value = argument.partition("=")
    key = name.lstrip("+")
    if not assigned or key not in KEYS or value in _NULL or _PLAIN.fullmatch(value):
        return argument
    there = exists(value)
    several = sweeping and key not in RUN_DIRECTORIES and re.search(r"[,(]", value)
    # Hydra's own ways to write a path: quoted, or each special character after a backslash.
    meant = _QUOTED.fullmatch(value) or (_ESCAPED.search(value) and exists(_ESCAPED.sub(r"\1", value)))
    if not there and (several or meant):
        return argument
    return f"{name}={quoted(value, interpolated=key in RUN_DIRECTORIES)}"


def quoted(value: str, interpolated: bool = False) -> str:
    """Return a value that Hydra and OmegaConf read as ``value``.

    Args:
        value: The value.
        interpolated: Whether ``${...}`` in it is an interpolation.
    """
    text = value if interpolated else escaped(value)
    # Backslashes count only before a quote.
    return "'" + re.sub(r"(\\*)('|\Z)", lambda m: 2 * m[1] + ("\\'" if m[2] else ""), text) + "'"


def escaped(value: str) -> str:
    """Return a text that OmegaConf reads as ``value``, without interpolations."""
    return re.sub(r"(\\*)\$\{", lambda m: f"{2 * m[1]}\\${{", value)


def plain(value: str) -> str:
    """Return the value of an argument without the quotes that are meant for Hydra."""
    if exists(value) or not _QUOTED.fullmatch(value):
        return value
    # Of backslashes before a quote or the end half are meant, and one more for the quote itself.
    inside = re.compile(rf"(\\*)\\{value[0]}|(\\+)\Z")
    return inside.sub(lambda m: m[2][::2] if m[1] is None else m[1][::2] + value[0], value[1:-1])
