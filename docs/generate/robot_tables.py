"""Table of the robots that people own."""

from __future__ import annotations

import re
from collections.abc import Iterator

import yaml
from markdown_table import table

from gctd3.config.help import conf
from gctd3.config.presets import read
from gctd3.robots.sources import package_of, pip_name


def owned_robots() -> Iterator[str]:
    """List the options of robots whose files packages bring."""
    rows = []
    for file in sorted((conf() / "robot").glob("*.yaml")):
        sources = yaml.safe_load(file.read_text(encoding="utf-8")).get("robot", {}).get("sources", [])
        if sources:
            packages = ", ".join(pip_name(package_of(place)) for place in sources)
            rows.append((f"`{file.stem}`", re.split("[,;.(]", read(file).about)[0].strip(), packages))
    yield from table(("`robot=`", "Robot", "Packages, in the order of their use"), rows)


TABLES = {"owned-robots": owned_robots}
