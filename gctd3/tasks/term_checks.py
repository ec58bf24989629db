"""Checks of the terms of a task, with errors that name the key and the accepted values."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from gctd3.errors import ConfigError
from gctd3.tasks.terms import Array, Step, Term


def reading(where: str, term: Callable[..., Array], step: Step, *beside: Array) -> Array:
    """Call a term, with a clear error if it reads a missing array.

    Raises:
        ConfigError: If the term reads an array that is not remembered; the message names it and the remembered ones.
    """
    try:
        return term(*beside, step)
    except KeyError as error:
        raise ConfigError(
            f"{where} reads {error}, which is not remembered. Remembered: {', '.join(step.before)}."
        ) from error


def check_terms(where: str, terms: Mapping[str, Any], kind: type[Term]) -> dict[str, Any]:
    """Check that a mapping holds terms of one kind by name, and return it without those that are ``None``.

    Raises:
        ConfigError: If a value is not such a term, or its weight is not a finite number; the message names it and the
            accepted values.
    """
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
