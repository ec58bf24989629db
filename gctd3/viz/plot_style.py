"""Style of figures: each small enough for a phone, told apart with every kind of colour vision, on white and black."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

# After Okabe & Ito 2008, evened out in lightness.
COLOURS = ("#2a7fc1", "#d9822b", "#1a9a72", "#c45a9b", "#8c7ae6", "#b0a01e", "#d1495b", "#4db6c6")
RIGHT, LEFT = COLOURS[0], COLOURS[1]
INK = "#010203"  # of text and axes; stands for the page's own colour there
WIDTH, HEIGHT = 4.6, 2.9  # inches
STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "path.simplify_threshold": 0.3,  # invisible points of an SVG
    "font.size": 9,
    "font.family": "sans-serif",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.alpha": 0.18,
    "grid.color": INK,
    "text.color": INK,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.titlesize": 9,
    "xtick.color": INK,
    "ytick.color": INK,
    "figure.constrained_layout.use": True,
}
# Style of a legend.
_PLAIN: dict[str, Any] = {
    "frameon": False,
    "fontsize": 8,
    "labelcolor": INK,
    "handlelength": 1.2,
    "columnspacing": 1.2,
}


def colours(groups: Sequence[str]) -> dict[str, str]:
    """Assign a colour to each group."""
    return {group: COLOURS[i % len(COLOURS)] for i, group in enumerate(groups)}


def new(rows: int = 1, columns: int = 1, height: float = HEIGHT, sharex: bool = False) -> tuple[Figure, np.ndarray]:
    """Create a figure of the usual width with axes ``[rows, columns]``."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        return figure, figure.subplots(rows, columns, squeeze=False, sharex=sharex)


def legend(ax: Axes) -> None:
    """Place the legend above the axes, where it hides nothing, in as many columns as fit, at most 4."""
    labels = ax.get_legend_handles_labels()[1]
    if not labels:
        return
    widest = 30 + 4.2 * max(map(len, labels))  # points: the handle and the gap, then the letters
    ax.legend(
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
        ncols=max(1, min(4, int(72 * WIDTH / widest))),
        borderaxespad=0.1,
        **_PLAIN,
    )


def legend_of_all(figure: Figure, ax: Axes) -> None:
    """Place the legend of ``ax`` above all axes of the figure, whose lines have the same meaning."""
    shown = figure.legend(*ax.get_legend_handles_labels(), loc="outside upper center", ncols=4, **_PLAIN)
    for line in shown.get_lines():
        line.set_linewidth(1.5)  # thin lines have a colour that is hard to tell
