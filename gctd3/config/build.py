"""From YAML to typed settings: one pass that checks every key and value before any work starts.

A YAML mapping with a ``_target_`` becomes an instance of that dataclass; its keys must be the dataclass's fields and
their values of the annotated types. The dataclasses check ranges themselves.
"""

from __future__ import annotations

import inspect
import math
import os
import shlex
import sys
import types
import typing
from collections.abc import Callable, Collection, Mapping, Sequence
from importlib.util import find_spec
from typing import Any

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import MissingMandatoryValue

import gctd3
from gctd3.config.fields import TARGET, describe, find, is_settings, meanings, name_of
from gctd3.config.suggestions import nearest
from gctd3.errors import ConfigError, PackageError, suggest

OWN = "gctd3"
MODULES = "GCTD3_MODULES"  # environment variable: packages besides that the configuration of a run may name, by commas


def packages(config: Any) -> list[str]:  # noqa: ANN401 - any nesting
    """List the packages besides gctd3 that the targets of a configuration name, in their order."""
    names: dict[str, None] = {}
    if OmegaConf.is_config(config):
        config = OmegaConf.to_container(config)
    if isinstance(config, Mapping):
        for key, item in config.items():
            # In a flat configuration it is the last part of a key.
            if str(key).rpartition(".")[2] == TARGET and isinstance(item, str):
                names |= dict.fromkeys([item.partition(".")[0]])
            names |= dict.fromkeys(packages(item))
    elif isinstance(config, (list, tuple)):
        names |= dict.fromkeys(name for item in config for name in packages(item))
    return [name for name in names if name != OWN]


def again(config: Any, command: str, *arguments: str) -> str:  # noqa: ANN401
    """Return the line for a shell that runs a command on a run, and lets it import what the run's terms are made of.

    Args:
        config: The run's configuration, or what holds it.
        command: Name of the command.
        arguments: Its arguments.
    """
    needed = packages(config)
    around = [f"{MODULES}={','.join(needed)}"] if needed else []
    # It may have been set for the one command only.
    if needed and "PYTHONPATH" in os.environ:
        around.insert(0, f"PYTHONPATH={shlex.quote(os.environ['PYTHONPATH'])}")
    return " ".join([*around, f"python -m {OWN}.{command}", *map(shlex.quote, arguments)])


def build(
    config: DictConfig | Mapping[str, Any],
    trusted: bool = True,
    besides: Collection[str] = (),
) -> Any:  # noqa: ANN401 - the target's
    """Build the settings of a configuration: call its targets, innermost first.

    Args:
        config: The configuration.
        trusted: Whether it may import any module, as the user's own command line may. The configuration of a run may be
            somebody else's: it may name only members of gctd3, of a package in ``GCTD3_MODULES``, or of a module
            that is imported already.
        besides: Further packages that it may name: those of the user's own command line.

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
        _check_modules(plain, {OWN, *_allowed(packages(plain)), *besides}, "")
    return _build(plain, "")


def _allowed(needed: Collection[str]) -> list[str]:
    """Return the packages that ``GCTD3_MODULES`` names.

    Raises:
        ConfigError: If one of them cannot be found.
    """
    names = [name.strip() for name in os.environ.get(MODULES, "").split(",") if name.strip()]
    for name in names:
        # Only looked for: what is named may never be needed.
        if name not in sys.modules and not (name.isidentifier() and find_spec(name)):
            raise ConfigError(f"{MODULES} must name packages, by commas; {name!r} is not found.{suggest(name, needed)}")
    return names


def _check_modules(value: Any, allowed: Collection[str], path: str) -> None:  # noqa: ANN401
    """Raise a :class:`.ConfigError` at the first target that would import a module that is not allowed."""
    if isinstance(value, list):
        for i, item in enumerate(value):
            _check_modules(item, allowed, f"{path}[{i}]")
    if not isinstance(value, Mapping):
        return
    for key, item in value.items():
        _check_modules(item, allowed, f"{path}.{key}".lstrip("."))
    target = value.get(TARGET)
    if not isinstance(target, str):
        return
    package, module = target.partition(".")[0], target.rpartition(".")[0]
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
    except PackageError:
        raise
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
    arguments = {
        key: _completed(value, hints.get(key), f"{path}.{key}".lstrip(".")) for key, value in arguments.items()
    }
    for key, value in arguments.items():
        full = f"{path}.{key}".lstrip(".")
        if key not in parameters:
            described = meanings(function)
            near = nearest(key, {name: described.get(name, "") for name in parameters})
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


def _completed(value: Any, hint: Any, path: str) -> Any:  # noqa: ANN401
    """Build the items of a mapping whose values are settings of one class, which need not be named."""
    inner = typing.get_args(hint)
    if not isinstance(value, Mapping) or typing.get_origin(hint) is not Mapping:
        return value
    classes = [option for option in (typing.get_args(inner[1]) or inner[1:]) if is_settings(option)]
    if len(classes) != 1 or inspect.isabstract(classes[0]):
        return value
    target = name_of(classes[0])
    return {k: _call(target, item, f"{path}.{k}") if isinstance(item, Mapping) else item for k, item in value.items()}


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
