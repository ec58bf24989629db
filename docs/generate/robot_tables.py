"""Tables of the robots that people own: where their files are, and how those that were trained walk."""

from __future__ import annotations

import re
import statistics
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from markdown_table import table
from result_tables import load

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


PICTURES = Path(__file__).parents[1] / "robots"


def _trainings() -> dict[str, list[dict[str, Any]]]:
    """Return the trainings of each robot that people own."""
    found: dict[str, list[dict[str, Any]]] = {}
    for row in load("robots_train")["rows"]:
        found.setdefault(row["robot"], []).append(row)
    return found


def trained_robots() -> Iterator[str]:
    """List the trainings of robots that people own, a row a robot: medians over its seeds, and their range."""
    rows = []
    for robot, trained in _trainings().items():
        done = [row for row in trained if "failed" not in row]
        source = _source(done[0]) if done else ""
        cells = [f"`{robot}`", _arriving(trained)]
        cells += [_middle(done, "seconds", "{:.0f}"), _middle(done, "frames", "{:,.0f}")]
        cells += [_middle(done, "speed_m_s", "{:.2f}"), _middle(done, "stride_hz", "{:.1f}")]
        cells += [_middle(done, "periodic_share", "{:.0%}"), _middle(done, "slip_m_s", "{:.2f}")]
        cells += [_middle(done, "height_from_home", "{:+.0%}"), _middle(done, "saturation_percent", "{:.0f} %"), source]
        rows.append(cells)
    heads = (
        "`robot=`",
        "seeds with 50 of 50",
        "seconds",
        "frames",
        "m/s",
        "stride, Hz",
        "periodic",
    )
    yield from table((*heads, "slip, m/s", "height from home", "saturated", "file"), rows)


def robot_pictures() -> Iterator[str]:
    """Show a strip of frames of each robot that was drawn."""
    rows = [(f"`{robot}`", _picture(robot, "robots")) for robot in _trainings() if _picture(robot, "robots")]
    yield from table(("`robot=`", "a frame every 0.1 s, at 7 m"), rows)


def shown_robots() -> Iterator[str]:
    """Show each robot that was trained, for the front page: its picture, whether and how soon it walks, its file."""
    rows = []
    for robot, trained in _trainings().items():
        done = [row for row in trained if "failed" not in row]
        if not done:
            continue
        cells = [f"`{robot}`", _picture(robot, "docs/robots"), _arriving(trained)]
        cells += [_middle(done, "seconds", "{:.0f}"), _middle(done, "speed_m_s", "{:.2f}"), _source(done[0])]
        rows.append(cells)
    yield from table(("`robot=`", "", "seeds with 50 of 50", "seconds", "m/s", "file, licence"), rows)


def _picture(robot: str, folder: str) -> str:
    drawn = (PICTURES / f"{robot}.png").is_file()
    return f"![{robot} walking]({folder}/{robot}.png)" if drawn else ""


def _arriving(trained: list[dict[str, Any]]) -> str:
    """Tell with how many seeds every episode reached the finish."""
    full = [row for row in trained if "failed" not in row and row["finishes"] == row["episodes"]]
    return f"{len(full)} of {len(trained)}"


def _source(row: dict[str, Any]) -> str:
    return f"{row['package']} {row['version']}, {row['licence'] or 'no licence stated'}"


def _middle(rows: list[dict[str, Any]], key: str, form: str) -> str:
    """Return the median of a number, and its range where there are several."""
    values = sorted(row[key] for row in rows if row[key] is not None)
    if not values:
        return "-"
    middle, low, high = (form.format(value) for value in (statistics.median(values), values[0], values[-1]))
    return middle if low == high else f"{middle} ({low} to {high})"


TABLES = {
    "owned-robots": owned_robots,
    "trained-robots": trained_robots,
    "robot-pictures": robot_pictures,
    "shown-robots": shown_robots,
}
