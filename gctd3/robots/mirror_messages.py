"""Words of the mirror check's messages: parts with their mirror images, percentages, lengths."""

from __future__ import annotations

from gctd3.robots.mjcf import Joint


def joint_pair(joint: Joint, other: Joint) -> str:
    """Name a joint and its mirror image, which may be the joint itself."""
    return name_pair(joint.name, other.name)


def name_pair(one: str, two: str) -> str:
    """Name a part and its mirror image, which may be the part itself."""
    return f"{one!r}" if one == two else f"{one!r} and its mirror image {two!r}"


def percent(part: float) -> str:
    """Write a part of 1 as a percentage."""
    return f"{100 * part:.2g} %" if part < 0.1 else f"{100 * part:.0f} %"


def millimetres(metres: float) -> str:
    """Write a length (m) in millimetres."""
    return f"{1000 * metres:.3g} mm"
