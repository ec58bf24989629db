"""What the commands are, and what ``--help`` says of each: read from conf/, so that it says what is true. Light."""

from __future__ import annotations

import re
import shutil
import sys
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources
from importlib.util import find_spec
from typing import TYPE_CHECKING, NoReturn

import yaml

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable

CONF = "gctd3.conf"
HELP = ("--help", "-h")
USAGE_ERROR = 2
# In the order in which one meets them.
COMMANDS = ("view", "render", "train", "evaluate", "report", "graph", "export")
_ROOTS = {"train": "config"}  # YAMLs that are not called as their command is
_KEY = re.compile(r"(?P<indent> *)(?P<key>\w+):(?: +(?P<value>[^#]*?))?(?: +# *(?P<comment>.*))?$")
_CHOICE = re.compile(r" +- (?P<group>\w+)(?:@(?P<place>[\w.]+))?: (?P<option>\w+)(?: +# *(?P<comment>.*))?$")
_NARROW, _WIDE = 60, 112  # columns


@dataclass(frozen=True)
class Key:
    """Something that a command line may say.

    Attributes:
        name: Dotted.
        value: That it has if nothing is said; ``...`` if something must be.
        said: What it means.
    """

    name: str
    value: str
    said: str


def fail(message: str) -> NoReturn:
    """End the program with a message on stderr."""
    print(f"error: {message}", file=sys.stderr)
    raise SystemExit(USAGE_ERROR)


def check_installed() -> None:
    """End the program if its YAMLs are not where Python finds them."""
    if find_spec(CONF) is None:
        fail(
            "gctd3 was imported from a source tree in which it is not installed: "
            "run `pip install -e .` there, or leave it."
        )


def asks_for_help() -> bool:
    """Whether the command line does."""
    return any(argument in HELP for argument in sys.argv[1:])


def command_of(root: str) -> str:
    """The command whose YAML is called ``root``."""
    return next((command for command, name in _ROOTS.items() if name == root), root)


def conf() -> Traversable:
    """The folder of YAMLs."""
    return resources.files(CONF)


def summary(command: str) -> str:
    """What a command does, in a line: the first one of its YAML."""
    first = _text(command).splitlines()[0]
    return first.partition(": ")[2].rstrip(".")


def overview() -> str:
    """What there is, for who has just installed it."""
    import gctd3

    rows = [f"  python -m gctd3.{command:10} {summary(command)}" for command in COMMANDS]
    return "\n".join(
        [
            f"gctd3 {gctd3.__version__}: train, compare and ship graph-structured policies for legged robots.",
            "",
            *rows,
            "",
            "Each takes key=value arguments and says which with --help. Scripts do the same: gctd3-train and so on.",
            "To begin:  python -m gctd3.view, to see it walk, and python -m gctd3.train algo=gctd3, to train it.",
        ]
    )


def help_of(command: str) -> str:
    """What a command does, examples, and the keys that its own YAML holds, with their defaults and comments."""
    text = _text(command)
    about = yaml.safe_load(text)["hydra"]["help"]["template"].rstrip()
    lines = [about, "", "Keys (key=default):", *_table(keys(command))]
    chosen = list(choices(command))
    if chosen:
        lines += ["", "Choices (group=option), each of which brings keys of its own:", *_table(chosen)]
        lines += ["", f"`python -m gctd3.{command} --cfg job` shows every key, also after choices on the same line."]
    return "\n".join(lines)


def keys(command: str) -> Iterator[Key]:
    """The keys of a command's YAML, but those of its groups and Hydra's."""
    path: list[str] = []
    said: list[str] = []
    goes_on = False  # whether the line before was a comment too
    for line in _text(command).splitlines():
        if line.strip().startswith("#"):
            words = line.strip("# ")
            said, goes_on = [*said, words] if goes_on else [words], True
            continue
        goes_on = False
        match = _KEY.match(line)
        if match is None:
            # A comment is shared by all keys below it, up to an empty line.
            said = said if line.strip() else []
            continue
        path = [*path[: len(match["indent"]) // 2], match["key"]]
        if path[0] in ("defaults", "hydra") or path[-1] == "_target_" or not match["value"]:
            continue
        value = "..." if match["value"] == "???" else match["value"]
        yield Key(".".join(path), value, match["comment"] or " ".join(said))


def choices(command: str) -> Iterator[Key]:
    """The groups of a command's YAML."""
    for line in _text(command).splitlines():
        match = _CHOICE.match(line)
        if match is None:
            continue
        files = conf().joinpath(match["group"]).iterdir()
        options = ", ".join(sorted(file.name.removesuffix(".yaml") for file in files if file.name.endswith(".yaml")))
        name = match["group"] + (f"@{match['place']}" if match["place"] else "")
        comment = match["comment"]
        yield Key(name, match["option"], f"{comment[0].upper()}{comment[1:]}: {options}" if comment else options)


def _text(command: str) -> str:
    return conf().joinpath(f"{_ROOTS.get(command, command)}.yaml").read_text(encoding="utf-8")


def _table(rows: Iterator[Key] | list[Key]) -> Iterator[str]:
    said = [(f"  {row.name}={row.value}", row.said) for row in rows]
    left = max(len(key) for key, _ in said) + 2
    width = min(max(shutil.get_terminal_size((100, 24)).columns, _NARROW), _WIDE)
    for key, comment in said:
        lines = textwrap.wrap(comment, max(width - left, 30)) or [""]
        yield f"{key:{left}}{lines[0]}".rstrip()
        yield from (" " * left + line for line in lines[1:])
