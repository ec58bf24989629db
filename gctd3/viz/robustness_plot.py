"""Plots of robustness: success under each condition, pushes survived over the stride."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gctd3.evaluation.robustness import DIRECTIONS
from gctd3.viz.plot_style import COLOURS, INK, STYLE, colours, legend, new

# The results of a group's policies, by the group's name.
Groups = Mapping[str, Sequence[Mapping[str, Any]]]


def conditions_figure(groups: Groups) -> Figure:
    """Plot the share of episodes that reach the finish under each condition, the mean over a group's policies."""
    figure, axes = new(height=_height(groups))
    _conditions(axes[0, 0], groups)
    return figure


def pushes_figure(groups: Groups) -> Figure | None:
    """Plot the largest impulse survived at each phase of the stride, a group's mean; ``None`` without any."""
    if not any(_largest(results, direction) is not None for results in groups.values() for direction in DIRECTIONS):
        return None
    figure, axes = new()
    _pushes(axes[0, 0], groups)
    return figure


def save(results: Mapping[str, Any], file: Path) -> None:
    """Save both plots of one policy as one PNG file."""
    groups = {"": [results]}
    figure, axes = new(2, 1, height=_height(groups) + 2.9)
    _conditions(axes[0, 0], groups)
    _pushes(axes[1, 0], groups)
    with matplotlib.rc_context(STYLE):
        figure.savefig(file, format="png", dpi=160, facecolor="white")


def _height(groups: Groups) -> float:
    return 0.8 + sum(0.1 + 0.13 * len(groups) for _ in _names(groups))


def _names(groups: Groups) -> list[str]:
    return list(dict.fromkeys(name for results in groups.values() for one in results for name in one["conditions"]))


def _conditions(ax: Axes, groups: Groups) -> None:
    names = _names(groups)
    width = 0.8 / len(groups)
    for i, (group, colour) in enumerate(colours(list(groups)).items()):
        for row, name in enumerate(names):
            rates = [r["conditions"][name]["success_rate"] for r in groups[group] if name in r["conditions"]]
            if rates:
                place = row - 0.4 + width * (i + 0.5)
                label = group if row == 0 and group else None
                ax.barh(place, np.mean(rates), height=0.85 * width, color=colour, label=label)
                ax.plot(rates, [place] * len(rates), "|", color=INK, ms=4, alpha=0.6)
    ax.set(xlim=(0, 1.02), yticks=range(len(names)), ylim=(len(names) - 0.4, -0.6))
    ax.set_yticklabels(names)
    falls = any("fall_rate" in one for results in groups.values() for r in results for one in r["conditions"].values())
    ax.set_xlabel("share of episodes without a fall" if falls else "share of episodes that reach the finish")
    ax.grid(axis="y", visible=False)
    ax.set_axisbelow(True)
    if len(groups) > 1:
        legend(ax)


def _pushes(ax: Axes, groups: Groups) -> None:
    for group, colour in colours(list(groups)).items():
        for direction, sign in DIRECTIONS.items():
            values = _largest(groups[group], direction)
            if values is None:
                continue
            ax.plot(
                np.linspace(0, 1, len(values) + 1),
                np.append(values, values[0]),
                color=colour if len(groups) > 1 else COLOURS[int(sign < 0)],
                ls="-" if sign > 0 else "--",
                marker="o",
                ms=3,
                lw=1.6,
                # With several groups the colour stands for the group, and dashes for the backward direction.
                label=direction if len(groups) == 1 else group if sign > 0 else None,
            )
    ax.set(xlabel="part of the stride since a touchdown of the first foot", ylabel="impulse survived, N s")
    ax.set(xlim=(0, 1), ylim=(0, 1.06 * ax.dataLim.y1 if ax.lines else None))
    if ax.lines:
        legend(ax)


def _largest(results: Sequence[Mapping[str, Any]], direction: str) -> np.ndarray | None:
    """Return the mean over the policies with a result, shape ``[phases]``; another number of phases is left out."""
    impulses = [r["pushes"]["largest"][direction] for r in results if r.get("pushes")]
    rows = [np.array([np.nan if value is None else value for value in row], dtype=float) for row in impulses]
    rows = [row for row in rows if len(row) == len(rows[0]) and np.isfinite(row).any()]
    if not rows:
        return None
    known = np.isfinite(rows).sum(axis=0)
    return np.where(known > 0, np.nansum(rows, axis=0) / np.maximum(known, 1), np.nan)
