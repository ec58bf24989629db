"""The commands and the ``--help`` of each, read from settings and conf/, so that it is true. Light."""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import shutil
import sys
import textwrap
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from string import Template
from types import ModuleType
from typing import Any, NoReturn

import yaml

from gctd3.config.fields import REQUIRED, TARGET, find, in_plain_text, settings_of
from gctd3.config.terminal import prepare_output

CONF = "gctd3.conf"
HELP = ("--help", "-h")
USAGE_ERROR = 2
UNREAD = 141  # exit code that shells report for a program whose output nobody reads
# In the order in which one meets them.
COMMANDS = ("view", "render", "train", "evaluate", "report", "graph", "export", "crosscheck", "ros")
_ROOTS = {"train": "config"}  # YAMLs that are not called as their command is
_CHOICE = re.compile(r" +- (?P<group>\w+)(?:@(?P<place>[\w.]+))?: (?P<option>\w+)(?: +# *(?P<comment>.*))?$")
# Of groups whose option follows from those of others.
_FOLLOWING = re.compile(r" +- optional (?P<group>\w+): (?P<option>[\w${}]+)(?: +# *(?P<comment>.*))?$")
_NARROW, _WIDE = 60, 112  # columns
GROUPED = 10_000  # from where on digits of a number are grouped


@dataclass(frozen=True)
class Key:
    """Describe a key or a group that a command line may set.

    Attributes:
        name: The key, dotted.
        value: Its default; ``...`` if it must be given.
        meaning: Its meaning.
    """

    name: str
    value: str
    meaning: str


def fail(message: str) -> NoReturn:
    """End the program with a message on stderr."""
    print(f"error: {message}", file=sys.stderr)
    raise SystemExit(USAGE_ERROR)


def unread() -> NoReturn:
    """End the program silently: the reader of its output (``| head``) has closed it."""
    # At its exit Python flushes its buffers, and would report the closed pipe.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    raise SystemExit(UNREAD)


def show(text: str) -> None:
    """Print a text; end the program silently if nobody reads it."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        unread()


def check_installed() -> None:
    """End the program if Python cannot find its YAMLs."""
    if find_spec(CONF) is None:
        fail(
            "gctd3 was imported from a source tree in which it is not installed: "
            "run `pip install -e .` there, or leave it."
        )


def asks_for_help() -> bool:
    """Tell whether the command line asks for help."""
    return any(argument in HELP for argument in sys.argv[1:])


def helped(root: str) -> bool:
    """Print the help of a command if the command line asks for it, and return whether it does.

    Args:
        root: Name of the command's YAML.
    """
    check_installed()
    if asks_for_help():
        prepare_output()
        show(help_of(command_of(root)))
    return asks_for_help()


def command_of(root: str) -> str:
    """Return the command whose YAML is called ``root``."""
    return next((command for command, name in _ROOTS.items() if name == root), root)


def root_of(command: str) -> str:
    """Return the name of a command's YAML."""
    return _ROOTS.get(command, command)


def conf() -> Path:
    """Find the folder of YAMLs, without importing it: the import, which Hydra makes, installs the completion."""
    spec = find_spec(CONF)
    assert spec is not None and spec.submodule_search_locations is not None
    return Path(next(iter(spec.submodule_search_locations)))


def summary(command: str) -> str:
    """Summarise a command in a line: the first one of its YAML."""
    first = _text(command).splitlines()[0]
    return first.partition(": ")[2].rstrip(".")


def overview() -> str:
    """Describe all commands, for a new user."""
    import gctd3

    rows = [f"  python -m gctd3.{command:10} {summary(command)}" for command in COMMANDS]
    return "\n".join(
        [
            f"gctd3 {gctd3.__version__}: train, compare and ship graph-structured policies for legged robots.",
            "",
            *rows,
            "",
            "Each takes key=value arguments and lists them with --help. Scripts do the same: gctd3-train and so on.",
            "To begin:  python -m gctd3.view, to see it walk, and python -m gctd3.train algo=gctd3, to train it.",
        ]
    )


def help_of(command: str) -> str:
    """Describe a command, with examples, the keys of its settings with default and meaning, and its choices."""
    text = _text(command)
    about = yaml.safe_load(text)["hydra"]["help"]["template"].rstrip()
    with unloaded("mujoco"):
        described = list(keys(command))
    lines = [about, "", "Keys (key=default):", *_table(described)]
    chosen = list(choices(command))
    if chosen:
        lines += ["", "Choices (group=option), each of which brings keys of its own:", *_table(chosen)]
        lines += ["", f"`python -m gctd3.{command} --cfg job` shows every key, also after choices on the same line."]
        lines += ["`python -m gctd3.config.reference` explains each of them."]
    return "\n".join(lines)


@contextlib.contextmanager
def unloaded(package: str) -> Iterator[None]:
    """Import modules that import a package without running that package's code, until they use it.

    Settings say what a robot is without asking MuJoCo, but their modules import it for those who build one.
    """
    if package not in sys.modules:
        sys.modules[package] = _Unloaded(package)
    try:
        yield
    finally:
        if isinstance(sys.modules.get(package), _Unloaded):
            del sys.modules[package]


class _Unloaded(ModuleType):
    """Stand in for a package that is imported once one of its names is used."""

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - any name of the package
        if sys.modules.get(self.__name__) is self:
            del sys.modules[self.__name__]
        return getattr(import_module(self.__name__), name)


def keys(command: str) -> Iterator[Key]:
    """List the keys of a command's settings, except those of its groups, as the default options leave them."""
    plain = yaml.safe_load(_text(command))
    chosen = {choice.name: choice.value for choice in choices(command)}
    for match in filter(None, map(_FOLLOWING.match, _text(command).splitlines())):
        file = conf().joinpath(match["group"], f"{Template(match['option']).safe_substitute(chosen)}.yaml")
        if file.is_file():
            _merge(plain, yaml.safe_load(file.read_text(encoding="utf-8")))
    return _keys(plain, {choice.name.rpartition("@")[2] for choice in choices(command)}, "")


def _merge(into: dict[str, Any], more: Mapping[str, Any]) -> None:
    """Set what ``more`` gives, mappings key by key."""
    for key, value in more.items():
        old = into.get(key)
        if isinstance(value, Mapping) and isinstance(old, dict):
            _merge(old, value)
        else:
            into[key] = value


def _keys(given: Mapping[str, Any], taken: Collection[str], prefix: str) -> Iterator[Key]:
    """List the keys of settings that a YAML gives as ``given``, except those in ``taken``."""
    inner = []
    for setting in settings_of(find(given[TARGET])):
        name, value = f"{prefix}{setting.name}", given.get(setting.name, setting.default)
        if name not in taken and isinstance(value, Mapping) and TARGET in value:
            inner.append(_keys(value, taken, f"{name}."))
        elif name not in taken:
            yield Key(name, written(value), in_plain_text(setting.meaning))
    yield from itertools.chain(*inner)


def written(value: object) -> str:
    """Format a value for a command line; ``...`` for a required one."""
    if value == REQUIRED:
        return "..."
    if isinstance(value, list):
        return f"[{','.join(map(written, value))}]"
    if isinstance(value, Mapping):
        return f"{{{','.join(f'{key}:{written(item)}' for key, item in value.items())}}}"
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "null"}[value]
    if isinstance(value, float):
        return str(value).removesuffix(".0")
    return f"{value:_}" if isinstance(value, int) and value >= GROUPED else str(value)


def choices(command: str) -> Iterator[Key]:
    """List the groups of a command's YAML, with their default and options."""
    for line in _text(command).splitlines():
        match = _CHOICE.match(line) or _FOLLOWING.match(line)
        if match is None:
            continue
        files = conf().joinpath(match["group"]).iterdir()
        options = sorted(file.name.removesuffix(".yaml") for file in files if file.name.endswith(".yaml"))
        # What follows from other options is a choice of its own where it can be left out.
        if match.re is _FOLLOWING and "none" not in options:
            continue
        place = match.groupdict().get("place")
        name = match["group"] + (f"@{place}" if place else "")
        comment = match["comment"]
        listed = ", ".join(options)
        yield Key(name, match["option"], f"{comment[0].upper()}{comment[1:]}: {listed}" if comment else listed)


def _text(command: str) -> str:
    return conf().joinpath(f"{root_of(command)}.yaml").read_text(encoding="utf-8")


def _table(rows: Iterator[Key] | list[Key]) -> Iterator[str]:
    entries = [(f"  {row.name}={row.value}", row.meaning) for row in rows]
    left = max(len(key) for key, _ in entries) + 2
    width = min(max(shutil.get_terminal_size((100, 24)).columns, _NARROW), _WIDE)
    for key, comment in entries:
        lines = textwrap.wrap(comment, max(width - left, 30)) or [""]
        yield f"{key:{left}}{lines[0]}".rstrip()
        yield from (" " * left + line for line in lines[1:])
