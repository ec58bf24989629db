"""Read settings: the fields of a dataclass, their types, their defaults as YAML has them, and their meanings. Light.

A setting's default stands in its dataclass and nowhere else, and its meaning and unit in the ``Attributes:`` of that
dataclass's docstring. Command lines, ``--help`` and the reference all read them here.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
import types
import typing
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import gctd3
from gctd3.errors import PackageError

TARGET = "_target_"
REQUIRED = "???"  # in YAML, of a key that has no default
_ENTRY = re.compile(r"    (?P<name>\w+): (?P<text>.*)")
_ROLE = re.compile(r":\w+:`~?\.?(?P<name>[^`]*)`")
_CODE = re.compile(r"``(?P<text>[^`]*)``")
_OF_YAML = {"None": "null", "True": "true", "False": "false"}


@dataclass(frozen=True)
class Setting:
    """Describe a field of a dataclass of settings.

    Attributes:
        name: The field, which is the key in YAML.
        hint: Its type, resolved.
        default: Its default as YAML has it; ``???`` if it must be given.
        meaning: What it does, with its unit, from the docstring of its class.
    """

    name: str
    hint: Any
    default: Any
    meaning: str


def find(target: str) -> Any:  # noqa: ANN401 - any object
    """Import the object that a ``_target_`` names.

    Raises:
        ImportError: If it cannot be imported.
        PackageError: If a package that it needs cannot be imported, and what to do about it is known.
    """
    module, _, name = str(target).rpartition(".")
    try:
        return getattr(import_module(module), name)
    except PackageError:
        raise
    except Exception as error:  # a module may raise anything
        raise ImportError(str(error)) from error


def is_settings(thing: object) -> typing.TypeGuard[type]:
    """Tell whether ``thing`` is a dataclass, and not an instance of one."""
    return isinstance(thing, type) and dataclasses.is_dataclass(thing)


def settings_of(cls: type) -> list[Setting]:
    """Describe the fields of a dataclass, those of its bases first."""
    hints, texts, defaults = typing.get_type_hints(cls), meanings(cls), defaults_of(cls)
    return [Setting(name, hints[name], default, texts.get(name, "")) for name, default in defaults.items()]


def defaults_of(cls: type) -> dict[str, Any]:
    """Return the default of every field of a dataclass, as YAML has it."""
    defaults = {}
    for field in dataclasses.fields(cls):
        if field.default is not dataclasses.MISSING:
            defaults[field.name] = in_yaml(field.default)
        elif field.default_factory is not dataclasses.MISSING:
            defaults[field.name] = in_yaml(field.default_factory())
        elif field.init:
            defaults[field.name] = REQUIRED
    return defaults


def in_yaml(value: Any) -> Any:  # noqa: ANN401
    """Convert a value to YAML's form: a list for a tuple, a mapping with its ``_target_`` for settings."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {f.name: in_yaml(getattr(value, f.name)) for f in dataclasses.fields(value) if f.init}
        return {TARGET: name_of(type(value)), **fields}
    if isinstance(value, Mapping):
        return {key: in_yaml(item) for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [in_yaml(item) for item in value]
    return value


def name_of(cls: type) -> str:
    """Return the ``_target_`` of a class: its alias in ``gctd3``, if it has one, else its path."""
    if getattr(gctd3, cls.__name__, None) is cls:
        return f"{gctd3.__name__}.{cls.__name__}"
    return f"{cls.__module__}.{cls.__qualname__}"


def meanings(cls: type) -> dict[str, str]:
    """Read the meanings of a class's fields from the ``Attributes:`` of its docstring and its bases'."""
    texts: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        section = inspect.cleandoc(vars(base).get("__doc__") or "").partition("\nAttributes:\n")[2]
        name = None
        for line in section.splitlines():
            entry = _ENTRY.fullmatch(line)
            if entry:
                name = entry["name"]
                texts[name] = entry["text"]
            elif name is None or not line.startswith("     "):
                break  # another section
            else:
                texts[name] += " " + line.strip()
    return texts


def in_plain_text(meaning: str) -> str:
    """Format a meaning from a docstring for a terminal, with YAML's constants."""
    return _CODE.sub(lambda match: _OF_YAML.get(match["text"], match["text"]), _ROLE.sub(r"\g<name>", meaning))


def in_markdown(meaning: str) -> str:
    """Format a meaning from a docstring for a Markdown page, with YAML's constants."""
    marked = _CODE.sub(lambda match: f"`{_OF_YAML.get(match['text'], match['text'])}`", meaning)
    return _ROLE.sub(r"`\g<name>`", marked).replace("|", "\\|")


def describe(hint: Any) -> str:  # noqa: ANN401
    """Describe the values of a type in words."""
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return " or ".join(describe(option) for option in inner)
    if origin is typing.Literal:
        return ("one of " if len(inner) > 1 else "") + ", ".join(map(str, inner))
    if hint in (None, type(None)):
        return "null"
    kind = origin or hint
    if issubclass(kind, Mapping):
        return "a mapping" if not inner or inner[1] is Any else f"a mapping to {describe(inner[1])}"
    if issubclass(kind, Sequence) and kind is not str:
        return f"a list of {describe(inner[0])}" if inner and inner[0] is not Any else "a list"
    names = {int: "a whole number", float: "a number", bool: "true or false", str: "a text"}
    return names.get(hint, f"a {getattr(hint, '__name__', hint)} (a mapping with its _target_)")
