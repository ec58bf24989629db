"""Settings from ``key=value`` arguments without Hydra, for a command that runs on a robot. Light."""

from __future__ import annotations

import math
import types
import typing
from collections.abc import Sequence
from typing import Any, TypeVar

from gctd3.config.fields import describe, settings_of
from gctd3.errors import ConfigError, suggest

Settings = TypeVar("Settings")
_CONSTANTS: dict[str, Any] = {"null": None, "true": True, "false": False}


def parse(cls: type[Settings], arguments: Sequence[str]) -> Settings:
    """Build flat settings from a command line; of a key that is given twice the last value counts.

    Args:
        cls: Dataclass of the settings, whose fields are texts, numbers, truth values, one of several texts or null.
        arguments: The arguments, each ``key=value``.

    Raises:
        ConfigError: If an argument has another form, a key is unknown, or a value is of another type or out of range.
    """
    hints = {setting.name: setting.hint for setting in settings_of(cls)}
    given: dict[str, Any] = {}
    for argument in arguments:
        key, equals, text = argument.partition("=")
        if not equals:
            raise ConfigError(f"Arguments have the form key=value, got {argument!r}; --help lists the keys.")
        if key not in hints:
            raise ConfigError(f"Unknown key {key!r}.{suggest(key, hints)} Accepted: {', '.join(hints)}.")
        value = _value(_unquoted(text), hints[key])
        if value is _value:
            near = suggest(text, [option for option in _options(hints[key]) if isinstance(option, str)])
            raise ConfigError(f"{key} must be {describe(hints[key])}, got {text!r}.{near}")
        given[key] = value
    return cls(**given)


def _unquoted(text: str) -> str:
    return text[1:-1] if len(text) > 1 and text[0] == text[-1] and text[0] in "'\"" else text


def _value(text: str, hint: Any) -> Any:  # noqa: ANN401
    """Convert a text to a type; this function itself stands for a text that does not fit, since ``None`` is a value."""
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        # Null first, since a text would take it too.
        options = sorted(typing.get_args(hint), key=lambda option: option is not type(None))
        return next((value for option in options if (value := _value(text, option)) is not _value), _value)
    if typing.get_origin(hint) is typing.Literal:
        return text if text in typing.get_args(hint) else _value
    if hint is bool or hint is type(None):
        value = _CONSTANTS.get(text, _value)
        return value if isinstance(value, hint) else _value
    if hint is str:
        return text
    try:
        number = hint(text.replace("_", ""))
    except (ValueError, OverflowError):
        return _value
    return number if math.isfinite(number) else _value


def _options(hint: Any) -> list[Any]:  # noqa: ANN401
    inner = list(typing.get_args(hint))
    return inner if typing.get_origin(hint) is typing.Literal else [o for part in inner for o in _options(part)]
