"""Checks of the terms of a task, with errors that name the key and the accepted values."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from gctd3.errors import ConfigError, GCTD3Error, TermError
from gctd3.tasks.terms import Array, Term


def called(where: str, function: Callable[..., Any], *arguments: Any) -> Any:  # noqa: ANN401 - what it returns
    """Call a function of a term; an error that it raises becomes one that names the term.

    Args:
        where: Key of the term.
        function: The function.
        arguments: Its arguments.

    Raises:
        TermError: If it raises an error other than gctd3's own.
    """
    try:
        return function(*arguments)
    except GCTD3Error:
        raise
    except Exception as error:  # what a term raises is its own
        last = traceback.extract_tb(error.__traceback__)[-1]
        raise TermError(
            f"{where} failed in line {last.lineno} of {Path(last.filename).name}: {type(error).__name__}: {error}"
        ) from error


@contextmanager
def trying() -> Iterator[None]:
    """Raise a :class:`.ConfigError` in place of a :class:`.TermError`: a term that fails at once is a wrong setting."""
    try:
        yield
    except TermError as error:
        raise ConfigError(str(error)) from error.__cause__


def reading(where: str, term: Callable[..., Array], read: Mapping[str, Array], *arguments: Any) -> Array:  # noqa: ANN401
    """Call a term as :func:`called` does, with a clear error if it reads a missing array of ``read``.

    Raises:
        ConfigError: If the term reads an array that is not remembered; the message names it and the remembered ones.
        TermError: If it raises any other error.
    """
    try:
        return called(where, term, *arguments)
    except TermError as error:
        missing = error.__cause__
        if not isinstance(missing, KeyError) or missing.args[0] in read:
            raise
        raise ConfigError(
            f"{where} reads {missing}, which is not remembered. Remembered: {', '.join(read)}."
        ) from missing


def check_mapping(where: str, terms: object) -> None:
    """Raise a :class:`.ConfigError` unless ``terms`` is a mapping."""
    if not isinstance(terms, Mapping):
        raise ConfigError(f"{where} must be a mapping of terms by name, got {terms!r}.")


def check_terms(where: str, terms: Mapping[str, Any], kind: type[Term]) -> dict[str, Any]:
    """Check that a mapping holds terms of one kind by name, and return it without those that are ``None``.

    Raises:
        ConfigError: If a value is not such a term, or its weight is not a finite number; the message names it and the
            accepted values.
    """
    check_mapping(where, terms)
    for name, term in terms.items():
        if not isinstance(name, str):
            raise ConfigError(f"{where}: the names of terms must be text, got {name!r}.")
        if term is not None and not isinstance(term, kind):
            given = type(term).__name__ if isinstance(term, Term) else repr(term)
            raise ConfigError(
                f"{where}.{name} must be null or a mapping whose _target_ is a {kind.__name__}, got {given}."
            )
        weight = getattr(term, "weight", 0.0)
        if isinstance(weight, bool) or not isinstance(weight, (int, float)) or not np.isfinite(weight):
            raise ConfigError(f"{where}.{name}.weight must be a number, got {weight!r}.")
    return {name: term for name, term in terms.items() if term is not None}
