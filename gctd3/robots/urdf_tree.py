"""The tree of a URDF's links and joints: its check, the links that a joint names, and names in notes about them."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree

from gctd3.errors import RobotError, suggest


def check_tree(root: ElementTree.Element, file: Path) -> None:
    """Check that links and joints have names of their own, and that every joint names two links, no link twice."""
    links = _names(root, "link", file)
    _names(root, "joint", file)
    children, above = dict[str, str](), dict[str, str]()
    for joint in root.iterfind("joint"):
        name = joint.get("name", "")
        parent, child = joint_link(joint, "parent"), joint_link(joint, "child")
        for tag, link in (("parent", parent), ("child", child)):
            if link not in links:
                raise RobotError(
                    f"{file}: the {tag} of joint {name!r} must be a link, got {link!r}.{suggest(link, links)}"
                )
        if child in children:
            raise RobotError(
                f"{file}: link {child!r} must be the child of one joint, got {children[child]!r} and {name!r}."
            )
        children[child], above[child] = name, parent
        limit = joint.find("limit")
        for key, text in ({} if limit is None else limit.attrib).items():
            if math.isnan(_number(text)):
                raise RobotError(f"{file}: {key} of joint {name!r} must be a number, got {text!r}.")
        low, high = joint_range(joint)
        if low > high:
            raise RobotError(f"{file}: the limits of joint {name!r} must rise, got lower={low:g} and upper={high:g}.")
    # Each link has one joint above it at most: a way up that does not end goes round.
    for link in links:
        place, seen = link, set[str]()
        while place in above and place not in seen:
            seen.add(place)
            place = above[place]
        if place in seen:
            raise RobotError(f"{file}: links must form a tree; from {place!r} joints lead back to it.")


def joint_range(joint: ElementTree.Element) -> tuple[float, float]:
    """Return ``lower`` and ``upper`` of a joint's limit, which are 0 where they are not given (rad or m)."""
    limit = joint.find("limit")
    low, high = (0.0 if limit is None else float(limit.get(key, 0.0)) for key in ("lower", "upper"))
    return low, high


def joint_link(joint: ElementTree.Element, tag: str) -> str:
    """Return the link that a joint names as its parent or child; empty if it names none."""
    end = joint.find(tag)
    return "" if end is None else end.get("link", "")


def _names(root: ElementTree.Element, tag: str, file: Path) -> set[str]:
    """Return the names of all links or joints, which must be there and differ."""
    names = set[str]()
    for element in root.iterfind(tag):
        name = element.get("name", "")
        if not name or name in names:
            raise RobotError(
                f"{file}: every {tag} must have a name of its own, got {name!r}{' twice' if name else ''}."
            )
        names.add(name)
    return names


def _number(text: str) -> float:
    """Return the number that a text is; NaN for another text."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def first_names(names: list[str], separator: str = ", ") -> str:
    """List the first four names, and say how many more there are."""
    return separator.join(names[:4]) + (
        f"{'' if separator == ', ' else ';'} and {len(names) - 4} more" if len(names) > 4 else ""
    )
