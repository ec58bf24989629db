"""Read the YAMLs of conf/ without Hydra: the purpose of each, its base, its keys and their reasons. Light."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from gctd3.config.fields import TARGET
from gctd3.config.help import conf

_OURS = ("defaults", "hydra", TARGET)  # keys of a YAML that are no settings
_KEY = re.compile(r"""(?P<indent> *)(?P<key>\w+|"[^"]+"):(?: +(?P<value>[^#]*?))?(?: +# *(?P<comment>.*))?$""")
_EVERYWHERE = "# @package _global_"


@dataclass(frozen=True)
class Change:
    """Describe a key that a YAML sets.

    Attributes:
        key: The key, dotted, from the root of the YAML.
        value: Its value.
        why: The comment on its line, or above it.
    """

    key: str
    value: Any
    why: str


@dataclass(frozen=True)
class Preset:
    """Describe an option of a group.

    Attributes:
        group: The group.
        name: The option.
        about: The comment at the top of its YAML.
        target: Its own ``_target_``, if it names one.
        everywhere: Whether its keys stand at the root of the configuration, not below the group.
        base: The option of the group that it begins with, if any.
        chosen: Options of other groups that it chooses, by their group.
        changes: The keys that it sets, except Hydra's.
        sweep: Values of a sweep with it, by key.
    """

    group: str
    name: str
    about: str
    target: str | None
    everywhere: bool
    base: str | None
    chosen: dict[str, str]
    changes: list[Change]
    sweep: dict[str, str]


def groups() -> list[str]:
    """List the groups, nested groups too."""
    return sorted({file.parent.relative_to(conf()).as_posix() for file in conf().rglob("*/*.yaml")})


def presets(group: str) -> list[Preset]:
    """Read the options of a group, those that build on no other first."""
    options = [read(file) for file in sorted((conf() / group).glob("*.yaml"))]
    return sorted(options, key=lambda preset: (preset.base is not None, preset.name))


def read(file: Path) -> Preset:
    """Read an option from its YAML."""
    text = file.read_text(encoding="utf-8")
    plain = yaml.safe_load(text)
    base, chosen = None, {}
    for item in plain.get("defaults", []):
        if isinstance(item, str):
            base = base or (None if item == "_self_" else item.rpartition("/")[2].partition("@")[0])
            continue
        ((name, option),) = item.items()
        # override /group@place: option
        chosen[name.removeprefix("override ").lstrip("/").partition("@")[0]] = str(option)
    sweeper = plain.get("hydra", {}).get("sweeper", {}) if isinstance(plain.get("hydra"), dict) else {}
    return Preset(
        group=file.parent.relative_to(conf()).as_posix(),
        name=file.stem,
        about=_about(text),
        target=plain.get(TARGET),
        everywhere=text.startswith(_EVERYWHERE),
        base=base,
        chosen=chosen,
        changes=list(changes(text)),
        sweep=sweeper.get("params", {}),
    )


def changes(text: str) -> Iterator[Change]:
    """List the keys that a YAML sets.

    A comment is shared by the keys below it, up to a comment, an empty line or a key that stands further to the left.
    """
    plain = yaml.safe_load(text)
    lines = text.splitlines()
    path: list[str] = []
    above: list[str] = []
    column = 0  # of the comment
    goes_on = head = True  # the line before was a comment too; only the file's own comment was read so far
    for line in lines:
        if line.strip().startswith("#"):
            above, goes_on = [*above, line.strip("# ")] if goes_on else [line.strip("# ")], True
            column = _column(line)
            continue
        if head or not line.strip() or _column(line) < column:
            above = []
        goes_on = head = False
        match = _KEY.match(line)
        if match is None:
            continue
        path = [*path[: len(match["indent"]) // 2], match["key"].strip('"')]
        if path[0] in _OURS or path[-1] == TARGET:
            continue
        value = plain
        for key in path:
            value = value[key]
        # A list may stand below its key; what a mapping holds are keys of their own.
        if not match["value"] and not isinstance(value, list):
            continue
        yield Change(".".join(path), value, match["comment"] or " ".join(above))


def _column(line: str) -> int:
    return len(line) - len(line.lstrip())


def _about(text: str) -> str:
    lines = text.removeprefix(_EVERYWHERE).strip().splitlines()
    first = next((i for i, line in enumerate(lines) if not line.startswith("#")), len(lines))
    return " ".join(line.strip("# ") for line in lines[:first])
