"""Rewrite ``robot=my.xml`` of a command line for Hydra: the option that fits the file, and the file for its name."""

from __future__ import annotations

from pathlib import Path

from gctd3.config.help import conf
from gctd3.config.paths import exists, plain, quoted, sweeps
from gctd3.errors import ConfigError

FREE = "free"  # the option for a robot of one's own whose base is free
_DEFAULT = "biped"  # the option where none is chosen
_LIBRARY = "library"  # the option with which all tasks of other libraries begin


def robot_file(arguments: list[str]) -> list[str]:
    """Return arguments for Hydra, with an option and a name in place of a file, or several, that ``robot`` is given.

    Raises:
        RobotError: If there is no such file.
        ConfigError: If several need different options, or the task brings its own robot.
    """
    tasks = [argument.removeprefix("task=") for argument in arguments if argument.startswith("task=")]
    library, sweeping = bool(tasks) and _brings_its_robot(tasks[-1]), sweeps(arguments)
    return [part for argument in arguments for part in _rewritten(argument, library, sweeping)]


def _rewritten(argument: str, library: bool, sweeping: bool) -> list[str]:
    key, _, value = argument.partition("=")
    value = plain(value)
    # A comma may be a part of the name.
    places = value.split(",") if sweeping and not exists(value) else [value]
    if key != "robot" or not any(map(_is_file, places)):
        if key == "robot" and library and value != _DEFAULT:
            # Its keys would be those of a walk, which the task does not know.
            raise ConfigError(f"{argument}: a library's task brings its own robot; leave {argument} out.")
        return [argument]
    # Imported late, so that --help is answered at once.
    from gctd3.robots.load import floats
    from gctd3.robots.sources import find_place

    for place in places:
        if not _is_file(place):
            raise ConfigError(f"{argument}: {place} is an option and others are files; run them one by one.")
    # Quoted, so that a path may hold what Hydra's grammar would read as its own.
    rewritten = ["robot.name=" + ",".join(map(quoted, places))]
    if library:
        return rewritten  # which the task refuses
    free = [floats(find_place(place).file) for place in places]
    if any(free) and not all(free):
        floating, fixed = places[free.index(True)], places[free.index(False)]
        raise ConfigError(
            f"{argument}: {floating} has a free base and {fixed} has not, so they need different settings; "
            "run them one by one."
        )
    return [f"robot={FREE}", *rewritten] if all(free) else rewritten


def _brings_its_robot(task: str) -> bool:
    """Tell whether an option that ships with gctd3 is a task of another library."""
    if task == _LIBRARY:
        return True
    file = conf().joinpath("task", f"{task}.yaml")
    if not file.is_file():
        return False
    # Imported late, so that --help is answered at once.
    from gctd3.config.presets import read

    base = read(file).base
    return base is not None and _brings_its_robot(base)


def _is_file(place: str) -> bool:
    """Tell whether a robot is given by its file rather than by the name of an option."""
    if conf().joinpath("robot", f"{place}.yaml").is_file():
        return False
    from gctd3.robots.sources import SUFFIXES, is_path, package_of

    return Path(place).suffix in SUFFIXES or package_of(place) is not None or is_path(place)
