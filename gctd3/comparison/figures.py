"""The report's figures, each small enough for a phone: drawn once, saved as SVG and PNG, and put into the page."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import MaxNLocator
from PIL import Image

from gctd3.comparison.groups import typical, with_trace
from gctd3.comparison.runs import Run
from gctd3.comparison.statistics import improvement, intervals, profile
from gctd3.comparison.verdict import scores
from gctd3.files import write_text
from gctd3.robots.robot import Robot
from gctd3.viz.film import sheet
from gctd3.viz.plot_style import COLOURS, INK, LEFT, RIGHT, STYLE, colours, legend, legend_of_all, new

SECONDS = 3.0  # of the traces
STRIDES_SECONDS = 6.0  # of the phase portraits
POINTS = 60  # of a curve
PALETTE = 128  # colours of a PNG
FILM_COLUMNS = 4  # of a film's PNG


@dataclass(frozen=True)
class Picture:
    """Hold a figure as HTML with its title and caption.

    Attributes:
        name: Name of its files, without a suffix.
        title: Title above it.
        caption: Caption below it.
        body: HTML for the page: a transparent SVG in the page's own text colour, or images.
    """

    name: str
    title: str
    caption: str
    body: str


class Gallery:
    """Save figures to a directory, and make them pictures for the page.

    Args:
        directory: Directory to write to, made if it is missing.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        directory.mkdir(parents=True, exist_ok=True)

    def add(self, figure: Figure, name: str, title: str, caption: str) -> Picture:
        """Save a figure as SVG and PNG, and return it as a picture for the page."""
        # Names of runs and joints are no formulas of matplotlib's.
        for text in figure.findobj(Text):
            text.set_parse_math(False)
        with matplotlib.rc_context({**STYLE, "svg.hashsalt": name}):
            pixels = io.BytesIO()
            figure.savefig(pixels, format="png", dpi=160, facecolor="white")
            # No date, so that equal numbers make equal files.
            alone, inside = io.StringIO(), io.StringIO()
            figure.savefig(alone, format="svg", facecolor="white", metadata={"Date": None})
            figure.savefig(inside, format="svg", transparent=True, metadata={"Date": None})
        _save_png(Image.open(pixels), self.directory / f"{name}.png")
        write_text(self.directory / f"{name}.svg", shorter(alone.getvalue()))
        return Picture(name, title, caption, inline(shorter(inside.getvalue()), name, title))

    def add_film(self, frames: Sequence[tuple[Image.Image, str]], name: str, title: str, caption: str) -> Picture:
        """Save frames as one PNG, and return them as a picture for the page, with each frame's words below it."""
        _save_png(sheet([image for image, _ in frames], FILM_COLUMNS), self.directory / f"{name}.png")
        body = "".join(
            f"<div>{_img(image, f'{title}, {words}')}<small>{escape(words)}</small></div>" for image, words in frames
        )
        return Picture(name, title, caption, f'<div class="film">{body}</div>')


def _img(image: Image.Image, words: str) -> str:
    stream = io.BytesIO()
    image.save(stream, format="JPEG", quality=80, optimize=True)
    data = base64.b64encode(stream.getvalue()).decode()
    return f'<img alt="{escape(words)}" src="data:image/jpeg;base64,{data}">'


def _save_png(image: Image.Image, file: Path) -> None:
    # A figure has few colours, and a palette reduces the file to a third.
    image.convert("RGB").quantize(PALETTE, dither=Image.Dither.NONE).save(file, optimize=True)


def shorter(svg: str) -> str:
    """Reduce the path coordinates of a matplotlib SVG to a tenth of a point, from a millionth."""
    return re.sub(r' d="[^"]*"', lambda path: re.sub(r"-?\d+\.\d{2,}", _tenths, path[0]), svg)


def _tenths(number: re.Match[str]) -> str:
    return f"{float(number[0]):.1f}".removesuffix(".0")


def inline(svg: str, name: str, title: str) -> str:
    """Convert a matplotlib SVG for use in a page: sized by the page, in its text colour, with ids of its own."""
    body = svg[svg.index("<svg") :].replace(INK, "currentColor")
    body = re.sub(r'<svg [^>]*?viewBox="([^"]*)"[^>]*>', r'<svg viewBox="\1" role="img">', body, count=1, flags=re.S)
    body = re.sub(r"<metadata>.*?</metadata>", f"<title>{escape(title)}</title>", body, flags=re.S)
    body = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', body)
    body = re.sub(r"url\(#([^)]+)\)", rf"url(#{name}-\1)", body)
    return re.sub(r'href="#([^"]+)"', rf'href="#{name}-\1"', body)


def curves(
    groups: Mapping[str, Sequence[Run]], x: str, label: str, scale: float = 1.0, mark: float | None = None
) -> Figure | None:
    """Plot the return over ``x``, a column of ``progress.csv``: interquartile mean over seeds and its interval.

    Between evaluations lines are straight; past a run's last one its last value stands. ``mark`` is an ``x`` to draw a
    vertical line at. The result is ``None`` if no run has ``x``.
    """
    figure, axes = new()
    ax, drawn = axes[0, 0], False
    for (group, runs), colour in zip(groups.items(), colours(list(groups)).values(), strict=True):
        lines = [
            np.array([(row[x] / scale, row["return_mean"]) for row in run.rows if x in row and "return_mean" in row])
            for run in runs
        ]
        lines = [line for line in lines if len(line)]
        if not lines:
            continue
        drawn = True
        grid = np.linspace(max(line[0, 0] for line in lines), max(line[-1, 0] for line in lines), POINTS)
        point, ends = intervals(np.stack([np.interp(grid, *line.T) for line in lines]))
        ax.plot(grid, point, color=colour, label=f"{group} ({len(lines)})", lw=1.8)
        if np.isfinite(ends).all():
            ax.fill_between(grid, *ends, color=colour, alpha=0.18, lw=0)
        ax.plot(*np.array([line[-1] for line in lines]).T, "o", color=colour, ms=3, alpha=0.7)
    if mark is not None:
        ax.axvline(mark / scale, color=INK, lw=0.8, ls="--")
    ax.set(xlabel=label, ylabel="return")
    legend(ax)
    return figure if drawn else None


def performance(groups: Mapping[str, Sequence[Run]]) -> Figure:
    """Plot performance profiles: for each return, the share of runs above it."""
    figure, axes = new()
    known = {group: scores(runs, "return_mean") for group, runs in groups.items()}
    every = [score for values in known.values() for score in values]
    margin = 0.05 * (max(every) - min(every)) + 1e-9
    thresholds = np.linspace(min(every) - margin, max(every) + margin, 200)
    for group, colour in colours(list(groups)).items():
        if known[group]:
            point, ends = profile(known[group], thresholds)
            axes[0, 0].plot(thresholds, point, color=colour, label=group, lw=1.8)
            if np.isfinite(ends).all():
                axes[0, 0].fill_between(thresholds, *ends, color=colour, alpha=0.15, lw=0)
    axes[0, 0].set(xlabel="return", ylabel="share of runs above it", ylim=(-0.03, 1.03))
    legend(axes[0, 0])
    return figure


def improvements(groups: Mapping[str, Sequence[Run]]) -> Figure | None:
    """Plot the probability that a run of the first group returns more than one of each other group."""
    names = list(groups)
    known = {group: scores(runs, "return_mean") for group, runs in groups.items()}
    others = [name for name in names[1:] if known[name]]
    if not others or not known[names[0]]:
        return None
    figure, axes = new(height=1.1 + 0.42 * len(others))
    ax = axes[0, 0]
    for i, other in enumerate(others):
        chance = improvement(known[names[0]], known[other])
        if np.isfinite(chance.low):
            ax.barh(i, chance.high - chance.low, left=chance.low, height=0.5, color=COLOURS[0], alpha=0.3)
        ax.plot([chance.value] * 2, [i - 0.25, i + 0.25], color=COLOURS[0], lw=2.5)
    ax.axvline(0.5, color=INK, lw=0.8, ls="--")
    ax.set(xlim=(0, 1), yticks=range(len(others)), ylim=(len(others) - 0.4, -0.6))
    ax.set_yticklabels([f"over {other}" for other in others])
    ax.set_xlabel(f"probability that {names[0]} returns more")
    return figure


def joint_pairs(robot: Robot) -> list[tuple[str, str]]:
    """Return the joints of the first leg with a mirror image, from the hip down, each with its mirror image."""
    for leg in robot.legs:
        pairs = [(joint.name, robot.mirror[joint.name]) for joint in leg if robot.mirror[joint.name] != joint.name]
        if pairs:
            return pairs
    return []


def joint_traces(trace: Mapping[str, np.ndarray], robot: Robot) -> Figure:
    """Plot the joint angles of one leg against those of its mirror image, over the last seconds."""
    pairs, late = joint_pairs(robot), _late(trace)
    figure, axes = new(len(pairs), height=0.5 + 1.15 * len(pairs), sharex=True)
    for ax, (first, second) in zip(axes[:, 0], pairs, strict=True):
        for name, colour in ((first, RIGHT), (second, LEFT)):
            angle = trace[f"angle_{name}_rad"][late] * (1.0 if name == first else robot.mirror_sign(second))
            ax.plot(trace["time_s"][late], angle, color=colour, lw=1.4, label=name.replace("_", " "))
        legend(ax)
        ax.set_ylabel("rad")
    axes[-1, 0].set_xlabel("time, s")
    return figure


def body_height(groups: Mapping[str, Sequence[Run]]) -> Figure:
    """Plot the body height over the last seconds of each group's typical run."""
    figure, axes = new()
    for (group, runs), colour in zip(groups.items(), colours(list(groups)).values(), strict=True):
        run = typical(with_trace(runs))
        if run is not None and run.trace is not None:
            late = _late(run.trace)
            time = run.trace["time_s"][late]
            axes[0, 0].plot(time - time[-1], run.trace["height_m"][late], color=colour, lw=1.3, label=group)
    axes[0, 0].axhline(0.0, color=INK, lw=0.6, ls=":")
    axes[0, 0].set(xlabel="time before the end, s", ylabel="height from standing, m")
    legend(axes[0, 0])
    return figure


def contacts(trace: Mapping[str, np.ndarray], robot: Robot) -> Figure:
    """Plot the contacts of each foot with the ground (Hildebrand 1965), over the last seconds."""
    late = _late(trace)
    time = trace["time_s"][late]
    dt = float(time[1] - time[0]) if len(time) > 1 else 0.02
    figure, axes = new(height=0.75 + 0.28 * len(robot.feet))
    ax = axes[0, 0]
    for i, foot in enumerate(robot.feet):
        down = trace[f"down_{foot}"][late] > 0.5
        colour = LEFT if robot.mirror_feet[i] < i else RIGHT
        edges = np.flatnonzero(np.diff(np.concatenate([[False], down, [False]]).astype(int))).reshape(-1, 2)
        bars = [(time[begin] - dt, (end - begin) * dt) for begin, end in edges]
        ax.broken_barh(bars, (i - 0.32, 0.64), color=colour, lw=0)
    ax.set(yticks=range(len(robot.feet)), ylim=(len(robot.feet) - 0.45, -0.55), xlabel="time, s")
    ax.set_yticklabels([foot.replace("_", " ") for foot in robot.feet])
    ax.grid(axis="y", visible=False)
    return figure


def phase_portraits(trace: Mapping[str, np.ndarray], robot: Robot) -> Figure:
    """Plot velocity over angle of each joint, right and left, over the last strides: a closed loop repeats itself."""
    pairs = joint_pairs(robot)
    settled = _late(trace, STRIDES_SECONDS)
    figure, axes = new(1, len(pairs), height=2.4)
    for ax, (first, second) in zip(axes[0], pairs, strict=True):
        for name, colour in ((first, RIGHT), (second, LEFT)):
            sign = 1.0 if name == first else robot.mirror_sign(second)
            angle, velocity = trace[f"angle_{name}_rad"][settled], trace[f"velocity_{name}_rad_s"][settled]
            ax.plot(sign * angle, sign * velocity, color=colour, lw=0.6, alpha=0.8, label=_side(name, first, second))
        ax.set(xlabel="rad", title=_shared(first, second))
        _few_ticks(ax)
    axes[0, 0].set_ylabel("rad/s")
    legend_of_all(figure, axes[0, 0])
    return figure


def _side(name: str, first: str, second: str) -> str:
    """Return the words of ``name`` that the two names do not share."""
    return " ".join(word for word in name.split("_") if word not in _shared(first, second).split()) or name


def _shared(first: str, second: str) -> str:
    """Return the words that two names share."""
    return " ".join(word for word in first.split("_") if word in second.split("_")) or first


def _few_ticks(ax: Axes) -> None:
    ax.xaxis.set_major_locator(MaxNLocator(2, min_n_ticks=1))
    ax.yaxis.set_major_locator(MaxNLocator(3))
    ax.tick_params(labelsize=8)


def _late(trace: Mapping[str, np.ndarray], seconds: float = SECONDS) -> np.ndarray:
    return np.asarray(trace["time_s"] > trace["time_s"][-1] - seconds)
