"""Rewrite ``robot=my.xml`` of a command line for Hydra: the option that fits the file, and the file for its name."""

from __future__ import annotations

from pathlib import Path

from gctd3.config.help import conf
from gctd3.errors import ConfigError

FREE = "free"  # the option for a robot of one's own whose base is free


def robot_file(argument: str) -> list[str]:
    """Return what Hydra reads in place of an argument that gives ``robot`` a file or several; any other as it is.

    Raises:
        RobotError: If there is no such file.
        ConfigError: If several need different options.
    """
    key, _, value = argument.partition("=")
    places = value.split(",")
    if key != "robot" or not any(map(_is_file, places)):
        return [argument]
    # Imported late, so that --help is answered at once.
    from gctd3.robots.load import floats
    from gctd3.robots.sources import find_place

    for place in places:
        if not _is_file(place):
            raise ConfigError(f"{argument}: {place} is an option and others are files; run them one by one.")
    # Quoted, so that a path may hold what Hydra's grammar would read as its own.
    rewritten = ["robot.name=" + ",".join("'" + place.replace("'", "\\'") + "'" for place in places)]
    free = [floats(find_place(place).file) for place in places]
    if any(free) and not all(free):
        floating, fixed = places[free.index(True)], places[free.index(False)]
        raise ConfigError(
            f"{argument}: {floating} has a free base and {fixed} has not, so they need different settings; "
            "run them one by one."
        )
    return [f"robot={FREE}", *rewritten] if all(free) else rewritten


def _is_file(place: str) -> bool:
    """Tell whether a robot is given by its file rather than by the name of an option."""
    if conf().joinpath("robot", f"{place}.yaml").is_file():
        return False
    from gctd3.robots.sources import SUFFIXES, package_of

    path = Path(place).expanduser()
    return path.suffix in SUFFIXES or package_of(place) is not None or path.is_file()
