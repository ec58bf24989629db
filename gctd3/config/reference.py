"""Write the reference of the configuration: ``python -m gctd3.config.reference > docs/configuration.md``. Light."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import yaml

from gctd3.config.fields import TARGET, Setting, describe, find, in_markdown, is_settings, settings_of
from gctd3.config.help import COMMANDS, choices, conf, root_of, show, summary, written
from gctd3.config.presets import Preset, groups, presets
from gctd3.config.terminal import prepare_output

# A key within a mapping by patterns, such as robot.servos.*_knee.stiffness.
_PATTERN = re.compile(r"(?P<outer>[\w.]+?)\.(?P<pattern>\w*[^\w.][^.]*)(?:\.(?P<inner>.+))?")
HEAD = """# Configuration

Every command takes `key=value` arguments. A key's default is that of a dataclass field, so that Python and the command
line agree; an option of a group, as in `algo=td3`, changes some of its keys: `conf/` says which and why. A key on the
command line overrides options, and an option overrides defaults. `python -m gctd3.COMMAND --cfg job` shows the result.

This page is written by `python -m gctd3.config.reference`, from those dataclasses and YAMLs.
"""


@dataclass(frozen=True)
class Row:
    """Describe a key in a table.

    Attributes:
        name: The key, dotted.
        setting: The field that the key sets.
    """

    name: str
    setting: Setting


def reference() -> str:
    """Write the whole reference page."""
    return "\n".join([HEAD, *_commands(), *_groups()]).rstrip() + "\n"


def rows(cls: type, taken: Collection[str] = (), prefix: str = "") -> Iterator[Row]:
    """List the keys of a settings class, those of nested settings last, except those in ``taken``."""
    inner = []
    for setting in settings_of(cls):
        name = f"{prefix}{setting.name}"
        if name in taken:
            continue
        target = setting.default.get(TARGET) if isinstance(setting.default, Mapping) else None
        nested = find(target) if target is not None else setting.hint
        if is_settings(nested):
            inner += list(rows(nested, taken, f"{name}."))
        else:
            yield Row(name, setting)
    yield from inner


def _commands() -> Iterator[str]:
    yield from ["## Commands", ""]
    for command in COMMANDS:
        plain = yaml.safe_load((conf() / f"{root_of(command)}.yaml").read_text(encoding="utf-8"))
        chosen = list(choices(command))
        taken = {choice.name.rpartition("@")[2] for choice in chosen}
        yield from [f"### `python -m gctd3.{command}`", "", f"{_sentence(summary(command))}.", ""]
        yield from _table(rows(find(plain[TARGET]), taken))
        yield ""
        if chosen:
            yield from ["| group | default | options |", "|---|---|---|"]
            yield from (f"| `{choice.name}` | `{choice.value}` | {choice.meaning} |" for choice in chosen)
            yield ""


def _groups() -> Iterator[str]:
    yield from ["## Groups", ""]
    for group in groups():
        yield from [f"### `{group}`", ""]
        options = presets(group)
        described: set[str] = set()
        for preset in options:
            settings = _settings(preset, options)
            if settings is not None and settings.__name__ not in described:
                described.add(settings.__name__)
                prefix = group.rpartition("/")[2] + "."
                yield from [f"Keys of `{settings.__name__}`: {_first_line(settings)}", ""]
                listed = list(rows(settings, prefix=prefix))
                yield from _table(listed) if listed else ["It has none."]
                yield ""
        yield from ["| option | meaning, and changes |", "|---|---|"]
        yield from (f"| `{preset.name}` | {_description(preset, options)} |" for preset in options)
        yield ""


def _settings(preset: Preset, options: list[Preset]) -> type | None:
    """Find the dataclass of an option, or that of the option on which it builds."""
    if preset.target is not None:
        cls = find(preset.target) if preset.target.startswith("gctd3.") else None
        return cls if is_settings(cls) else None
    base = next((other for other in options if other.name == preset.base), None)
    return _settings(base, options) if base is not None and not preset.everywhere else None


def _description(preset: Preset, options: list[Preset]) -> str:
    """Describe an option, the option on which it builds, and its changes."""
    parts = [preset.about]
    if preset.base is not None:
        parts.append(f"Begins with `{preset.base}`.")
    parts += [f"Chooses `{group}={option}`." for group, option in preset.chosen.items()]
    settings = _settings(preset, options)
    prefix = "" if preset.everywhere else f"{preset.group.rpartition('/')[2]}."
    defaults = {row.name: row.setting.default for row in rows(settings, prefix=prefix)} if settings else {}
    for change in preset.changes:
        name = f"{prefix}{change.key}"
        # A key with its default value is not a change, unless it undoes a change of the option's base.
        if preset.base is None and name in defaults and defaults[name] == change.value:
            continue
        parts.append(f"<br>`{_assigned(name, change.value)}`" + (f": {change.why}" if change.why else ""))
    if preset.sweep:
        parts.append("<br>With `-m` it sweeps " + ", ".join(f"`{k}={v}`" for k, v in preset.sweep.items()) + ".")
    return " ".join(parts).replace("|", "\\|")


def _assigned(key: str, value: Any) -> str:  # noqa: ANN401 - YAML's
    """Return the argument that sets a key; a pattern of joints is no key to Hydra's grammar, but one of a mapping."""
    match = _PATTERN.fullmatch(key)
    if match is None:
        return f"{key}={written(value)}"
    item = f"{{{match['inner']}:{written(value)}}}" if match["inner"] else written(value)
    return f"{match['outer']}={{{match['pattern']}:{item}}}"


def _table(listed: Iterator[Row] | list[Row]) -> Iterator[str]:
    yield from ["| key | default | type | meaning |", "|---|---|---|---|"]
    for row in listed:
        default, kind = written(row.setting.default), describe(row.setting.hint).replace("|", "\\|")
        yield f"| `{row.name}` | `{default}` | {kind} | {in_markdown(row.setting.meaning)} |"


def _first_line(cls: type[Any]) -> str:
    return in_markdown((cls.__doc__ or "").strip().partition("\n")[0])


def _sentence(text: str) -> str:
    return text[0].upper() + text[1:]


if __name__ == "__main__":
    prepare_output()
    show(reference().removesuffix("\n"))
