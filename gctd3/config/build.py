"""From YAML to typed settings: one pass that checks every key and value before any work starts.

A YAML mapping with a ``_target_`` becomes an instance of that dataclass; its keys must be the dataclass's fields and
their values of the annotated types. The dataclasses check ranges themselves.
"""

from __future__ import annotations

import inspect
import math
import os
import sys
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import MissingMandatoryValue

import gctd3
from gctd3.config.fields import TARGET, describe, find, is_settings, meanings
from gctd3.config.suggestions import nearest
from gctd3.errors import ConfigError, suggest

OWN = "gctd3"
MODULES = "GCTD3_MODULES"  # environment variable: packages besides that the configuration of a run may name, by commas


def build(config: DictConfig | Mapping[str, Any], trusted: bool = True) -> Any:  # noqa: ANN401 - the target's
    """Build the settings of a configuration: call its targets, innermost first.

    Args:
        config: The configuration.
        trusted: Whether it may import any module, as the user's own command line may. The configuration of a run may be
            somebody else's: it may name only members of gctd3, of a package in ``GCTD3_MODULES``, or of a module
            that is imported already.

    Raises:
        ConfigError: If a key is unknown or missing, or a value has the wrong type or is out of range.
    """
    plain: Any = config
    if isinstance(config, DictConfig):
        try:
            plain = OmegaConf.to_container(config, resolve=True, throw_on_missing=True)
        except MissingMandatoryValue as error:
            raise ConfigError(f"{error.full_key}=... is required; --help shows how.") from error
    if not trusted:
        _check_modules(plain, "")
    return _build(plain, "")


def _check_modules(value: Any, path: str) -> None:  # noqa: ANN401
    """Raise a :class:`.ConfigError` at the first target that would import a module that is not allowed."""
    if isinstance(value, list):
        for i, item in enumerate(value):
            _check_modules(item, f"{path}[{i}]")
    if not isinstance(value, Mapping):
        return
    for key, item in value.items():
        _check_modules(item, f"{path}.{key}".lstrip("."))
    target = value.get(TARGET)
    if not isinstance(target, str):
        return
    package, module = target.partition(".")[0], target.rpartition(".")[0]
    allowed = {OWN, *(name.strip() for name in os.environ.get(MODULES, "").split(","))}
    if package not in allowed and module not in sys.modules:
        raise ConfigError(
            f"{path or 'the configuration'}: _target_ {target!r} is not gctd3's, and nothing else is imported for the "
            f"configuration of a run. If you trust it, set the environment variable {MODULES}={package}."
        )


def _build(value: Any, path: str) -> Any:  # noqa: ANN401
    if isinstance(value, Mapping):
        inner = {key: _build(item, f"{path}.{key}".lstrip(".")) for key, item in value.items() if key != TARGET}
        return _call(value[TARGET], inner, path) if TARGET in value else inner
    if isinstance(value, list):
        return tuple(_build(item, f"{path}[{i}]") for i, item in enumerate(value))
    return value


def _call(target: str, arguments: Mapping[str, Any], path: str) -> Any:  # noqa: ANN401
    where = path or "the configuration"
    try:
        function = find(target)
    except ImportError as error:
        near = suggest(target, [f"{OWN}.{name}" for name in vars(gctd3)["_TARGETS"]])
        raise ConfigError(f"{where}: _target_ {target!r} cannot be imported: {error}{near}") from error
    # Nothing else is called, so that reading somebody's configuration cannot run a program.
    if not is_settings(function):
        raise ConfigError(f"{where}: _target_ {target!r} is not a dataclass of settings.")
    if inspect.isabstract(function):
        lacking = ", ".join(sorted(getattr(function, "__abstractmethods__", ())))
        raise ConfigError(f"{where}: _target_ {target!r} is abstract: a class that defines {lacking} is needed.")
    parameters = inspect.signature(function).parameters
    hints = _hints(function)
    for key, value in arguments.items():
        full = f"{path}.{key}".lstrip(".")
        if key not in parameters:
            said = meanings(function)
            near = nearest(key, {name: said.get(name, "") for name in parameters})
            raise ConfigError(f"Unknown key {full!r}.{near} Accepted: {', '.join(parameters)}.")
        if key in hints and not _fits(value, hints[key]):
            hint = suggest(value, _options(hints[key])) if isinstance(value, str) else ""
            raise ConfigError(f"{full} must be {describe(hints[key])}, got {value!r}.{hint}")
    missing = [n for n, p in parameters.items() if p.default is inspect.Parameter.empty and n not in arguments]
    if missing:
        raise ConfigError(f"{where} lacks {', '.join(missing)}.")
    converted = {key: _converted(value, hints.get(key)) for key, value in arguments.items()}
    try:
        return function(**converted)
    except ConfigError as error:
        # Targets name their own fields; the path to them is known here.
        raise ConfigError(f"{path}.{error}".lstrip(".")) from error
    except Exception as error:  # what a class from outside raises is its own
        if target.partition(".")[0] == OWN:
            raise
        raise ConfigError(f"{where}: {target} cannot be made: {type(error).__name__}: {error}") from error


def _hints(function: Callable[..., Any]) -> dict[str, Any]:
    return typing.get_type_hints(function)


def _converted(value: Any, hint: Any) -> Any:  # noqa: ANN401
    """Convert a value that fits: to a fraction where one is asked for, and to a list where only that is."""
    if isinstance(value, int) and _is_float(hint):
        return float(value)
    return list(value) if isinstance(value, tuple) and (typing.get_origin(hint) or hint) is list else value


def _is_float(hint: Any) -> bool:  # noqa: ANN401
    return float in (hint, *typing.get_args(hint)) and int not in typing.get_args(hint) and not isinstance(hint, bool)


def _fits(value: Any, hint: Any) -> bool:  # noqa: ANN401
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if hint is Any:
        return True
    if origin in (typing.Union, types.UnionType):
        return any(_fits(value, option) for option in inner)
    if origin is typing.Literal:
        return value in inner
    if hint in (None, type(None)):
        return value is None
    if hint is float:
        return isinstance(value, (int, float)) and not isinstance(value, bool) and _finite(value)
    if hint is int:
        return isinstance(value, int) and not isinstance(value, bool)
    kind = origin or hint
    if issubclass(kind, Mapping):
        return isinstance(value, Mapping) and (not inner or all(_fits(v, inner[1]) for v in value.values()))
    if issubclass(kind, Sequence) and kind is not str:
        return isinstance(value, (list, tuple)) and (not inner or all(_fits(v, inner[0]) for v in value))
    return isinstance(value, kind)


def _finite(value: float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number beyond every float
        return False


def _options(hint: Any) -> list[str]:  # noqa: ANN401
    """List the texts that a setting may be, if it is one of some."""
    inner = typing.get_args(hint)
    if typing.get_origin(hint) is typing.Literal:
        return [option for option in inner if isinstance(option, str)]
    return [option for part in inner for option in _options(part)]
