"""Plots of a policy under commanded velocities: what was commanded and what came of it, and the errors over the box."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes

from gctd3.viz.plot_style import COLOURS, INK, STYLE, new

AXES = {"forward_m_s": "forward, m/s", "side_m_s": "to the left, m/s", "turn_rad_s": "turning, rad/s"}


def save(results: Mapping[str, Any], file: Path) -> None:
    """Save the plots of the results of :func:`.command_grid.examine` as a PNG file."""
    figure, axes = new(3, 2, height=7.2)
    commands = results["commands"]
    for ax, (key, label) in zip(axes.ravel(), AXES.items(), strict=False):
        _followed(ax, commands, key, label)
    errors = axes.ravel()[3:]
    _over(errors[0], commands, "forward_m_s", "side_m_s", "error in the plane, m/s", _planar)
    _over(errors[1], commands, "forward_m_s", "turn_rad_s", "error of the yaw rate, rad/s", _turning)
    _over(errors[2], commands, "forward_m_s", "turn_rad_s", "share of falls", _falls)
    with matplotlib.rc_context(STYLE):
        figure.savefig(file, format="png", dpi=160, facecolor="white")


def _followed(ax: Axes, commands: Sequence[Mapping[str, Any]], key: str, label: str) -> None:
    """Plot the mean velocity over the commanded one; a cross on the axis marks a command under which all fell."""
    stood = [one for one in commands if one["mean"] is not None]
    asked = [one["command"][key] for one in stood]
    ax.axline((0, 0), slope=1, color=INK, lw=0.8, alpha=0.4)
    ax.plot(asked, [one["mean"][key] for one in stood], "o", ms=3, color=COLOURS[0], alpha=0.6)
    fell = [one["command"][key] for one in commands if one["mean"] is None]
    ax.plot(fell, [0.0] * len(fell), "x", ms=5, color=COLOURS[6])
    ax.set(xlabel=f"commanded {label}", ylabel="mean of the robot")


def _over(
    ax: Axes,
    commands: Sequence[Mapping[str, Any]],
    x: str,
    y: str,
    title: str,
    value: Any,  # noqa: ANN401 - a function
) -> None:
    """Plot a value over two axes of the commands as squares with their numbers, the mean over the third."""
    places: dict[tuple[float, float], list[float]] = {}
    for one in commands:
        found = value(one)
        if found is not None:
            places.setdefault((one["command"][x], one["command"][y]), []).append(found)
    if places:
        points, means = np.array(list(places)), np.array([np.mean(values) for values in places.values()])
        ax.scatter(points[:, 0], points[:, 1], c=means, cmap="viridis_r", marker="s", s=190, vmin=0.0)
        for point, mean in zip(points, means, strict=True):
            ax.annotate(f"{mean:.2f}", tuple(point), ha="center", va="center", fontsize=6, color="white")
    ax.margins(0.15)
    ax.set(xlabel=AXES[x], ylabel=AXES[y], title=title)
    ax.grid(visible=False)


def _planar(one: Mapping[str, Any]) -> float | None:
    error = one["mean_abs_error"]
    return None if error is None else float(np.hypot(error["forward_m_s"], error["side_m_s"]))


def _turning(one: Mapping[str, Any]) -> float | None:
    return None if one["mean_abs_error"] is None else float(one["mean_abs_error"]["turn_rad_s"])


def _falls(one: Mapping[str, Any]) -> float:
    return float(one["falls"]) / float(one["episodes"])
