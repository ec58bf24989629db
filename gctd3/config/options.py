"""The options of the groups in conf/, as far as a command line says. Light."""

from __future__ import annotations

import re

from gctd3.config.help import conf


def chooses(argument: str) -> str | None:
    """Return the group of which an argument chooses an option; ``None`` for other arguments, which add no keys."""
    group = re.split("[=@]", argument.lstrip("+~"), maxsplit=1)[0]
    return group if group.isidentifier() and conf().joinpath(group).is_dir() else None


def options(group: str) -> list[str]:
    """List the options of a group that ship with gctd3."""
    return sorted(file.stem for file in conf().joinpath(group).glob("*.yaml"))


def ships(argument: str) -> bool:
    """Tell whether the option that an argument chooses of a group ships with gctd3."""
    group, option = chooses(argument), argument.partition("=")[2]
    return group is not None and conf().joinpath(group, f"{option}.yaml").is_file()


def unchosen(group: str) -> str:
    """Return what to do about a group that has no keys, since no option of it was chosen."""
    return f"{group} has no keys as it is: begin with {group}=..., which is one of {', '.join(options(group))}."
