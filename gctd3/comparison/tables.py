"""The report's tables: the paper's Table 5 beside ours, robustness, the runs, differences of their configurations."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gctd3.comparison.cells import (
    ENDS,
    VALUE,
    Cell,
    columns_of_numbers,
    count,
    estimate,
    estimate_numbers,
    mean,
    mean_and_range,
    mean_and_sd,
    number,
    spread,
)
from gctd3.comparison.equal_time import Limit, reached_by
from gctd3.comparison.groups import differences
from gctd3.comparison.runs import Run
from gctd3.comparison.statistics import interval
from gctd3.comparison.verdict import Comparison, scores
from gctd3.evaluation.robustness import DIRECTIONS, weakest
from gctd3.robots.robot import Robot

# Table 5: return and its standard deviation over 50 episodes, body position (m), velocity (m/s).
PAPER = {
    "ddpg": (241.28, 89.44, -0.0114, 1.344),
    "sac": (224.18, 56.96, -0.0397, 0.619),
    "td3": (370.31, 37.26, -0.0020, 1.164),
    "gctd3": (380.0, 18.47, -0.0202, 1.414),
}
# Columns that a page does not treat as numbers.
UNIT, MEANING, OUTCOME, DIRECTORY, FINDING = "unit", "what it is", "outcome", "directory", "verdict"
TEXTS = ("", "key", UNIT, MEANING, OUTCOME, DIRECTORY, FINDING)  # columns without numbers; the first names the row
FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n")  # beginnings of what a spreadsheet computes
SEPARATED = r"[+-]?\d{1,3}(,\d{3})+(\.\d+)?"  # a number with separators of thousands


@dataclass(frozen=True)
class Table:
    """Hold a table of texts with a title, a note and a head.

    Attributes:
        name: Name of its file, without a suffix.
        title: Title above it.
        note: Note below it.
        head: Names of the columns.
        rows: Rows of cells.
    """

    name: str
    title: str
    note: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]

    def csv(self) -> str:
        """Return the table as the text of a CSV file, for programs and spreadsheets.

        Every number has a column of its own, without separators of thousands, and a cell without a value is empty. A
        text that a spreadsheet would compute, since it begins with ``=``, ``+``, ``-``, ``@``, a tab or a line break,
        has an apostrophe before it, which spreadsheets take for the mark of a text.
        """
        text = io.StringIO()
        head, *rows = columns_of_numbers(self.head, self.rows)
        plain = [[_plain(cell, column in TEXTS) for column, cell in zip(head, row, strict=True)] for row in rows]
        csv.writer(text, lineterminator="\n").writerows([[_plain(name, True) for name in head], *plain])
        return text.getvalue()


def _plain(cell: str, is_text: bool) -> str:
    """Return a cell of a CSV file: a number that programs read, or a text that nothing computes."""
    if cell == "-" and not is_text:
        return ""
    number = cell.replace(",", "") if not is_text and re.fullmatch(SEPARATED, cell) else cell
    if re.fullmatch(r"[+-]?\d+(\.\d+)?([eE][+-]?\d+)?", number):
        return number
    return f"'{cell}" if cell.startswith(FORMULA) else str(cell)


def table5(groups: Mapping[str, Sequence[Run]], robot: Robot | None, is_biped: bool) -> Table:
    """Return the table of return, body position from both references, velocity and success, ours and the paper's.

    Args:
        groups: Runs by the name of their group.
        robot: Robot of the runs; ``None`` for another library's task, whose body position from spawn is unknown.
        is_biped: Whether it is the paper's robot.
    """
    drop = spawn_height(robot) if robot is not None else np.nan
    rows = []
    for group, runs in groups.items():
        means = scores(runs, "return_mean")
        body, speed, won = (scores(runs, key) for key in ("body_position_mean", "velocity_mean", "success_rate"))
        rows.append(
            [
                group,
                count(len(means), len(runs)),
                spread(means, 1),
                estimate(interval(means), 1),
                mean(body, 4),
                mean([value - drop for value in body if np.isfinite(drop)], 4),
                estimate(interval(speed), 3),
                mean(won, 2),
            ]
        )
        algorithm = runs[0].algorithm
        if is_biped and algorithm in PAPER and not any(row[0] == f"paper, {algorithm.upper()}" for row in rows):
            returns, deviation, position, velocity = PAPER[algorithm]
            row = [f"paper, {algorithm.upper()}", "-", mean_and_sd(f"{returns}", f"{deviation}"), "-", "-"]
            rows.append([*row, number(position, 4), number(velocity, 3), "-"])
    return Table(
        "table5",
        "The paper's Table 5",
        f"Ours: mean ± standard deviation over seeds, each the mean of its {_episodes(groups)}; IQM is the "
        "interquartile mean over seeds with its 95 % interval. The paper's ± is over 50 episodes of one training, in "
        "another simulator: not like for like. Its body position seems to count from the height at which the robot is "
        "dropped" + (f", {drop:.4f} m above standing." if np.isfinite(drop) else "."),
        (
            "",
            "seeds evaluated",
            "return, mean ± sd",
            "return, IQM",
            "body from standing, m",
            "body from spawn, m",
            "velocity, m/s, IQM",
            "success",
        ),
        rows,
    )


def _episodes(groups: Mapping[str, Sequence[Run]]) -> str:
    """Return the number of episodes as ``50 episodes``, or ``episodes`` if it is unknown or differs between runs."""
    numbers = {run.evaluation.get("episodes") for runs in groups.values() for run in runs if run.evaluation}
    return f"{numbers.pop()} episodes" if len(numbers) == 1 and None not in numbers else "episodes"


def comparisons_table(compared: Sequence[Comparison]) -> Table:
    """Return the table of comparisons: difference, intervals, probability and verdict, a row for each."""
    rows = []
    for one in compared:
        cells: list[str] = ["-", "-", "-"]
        if one.values and one.chance:
            first, second = one.values
            gap = first.value - second.value
            numbers = [estimate_numbers(end, one.digits) for end in one.values]
            own = {which: part[VALUE] for which, part in zip(("first", "second"), numbers, strict=True)}
            ends = {
                f"{which} {end}": part.get(end, "") for which, part in zip(own, numbers, strict=True) for end in ENDS
            }
            text = f"{gap:+.{one.digits}f} ({own['first']} against {own['second']})"
            known = [f"[{part['low']}, {part['high']}]" if "low" in part else "one seed" for part in numbers]
            cells = [Cell(text, {VALUE: f"{gap:.{one.digits}f}", **own}), Cell("; ".join(known), ends)]
            cells.append(estimate(one.chance, 2))
        rows.append([one.what, one.unit.strip(), *cells, one.finding, f"{one.ours} against {one.theirs}"])
    return Table(
        "comparisons",
        "Comparisons",
        "Difference of interquartile means over seeds, the first group's minus the second's; their 95 % bootstrap "
        "intervals, on which the verdict rests; the probability that a run of the first has more than one of the "
        "second, with its interval: at 0.5 neither is ahead.",
        ("", UNIT, "difference", "95 % intervals", "probability of more", FINDING, MEANING),
        rows,
    )


def equal_time(groups: Mapping[str, Sequence[Run]], limit: Limit) -> Table:
    """Return the table of return, success, frames and updates that each group had reached at ``limit``."""
    columns = (("return_mean", 1.0, 1), ("success_rate", 1.0, 2), ("frames", 1e-3, 1), ("updates", 1e-3, 1))
    rows = []
    for group, known in reached_by(groups, limit.seconds).items():
        cells = [interval([scale * getattr(one, key) for one in known]) for key, scale, _ in columns]
        texts = [estimate(cell, column[-1]) if known else "-" for cell, column in zip(cells, columns, strict=True)]
        seeds = count(len(known), len(groups[group]))
        rows.append([group, seeds, *texts, number(limit.medians[group] / 60.0, 2)])
    return Table(
        "equal_time",
        "At equal wall-clock",
        f"What each run had reached after {limit.text} of wall-clock: the median training time of {limit.group}, the "
        "shortest of all groups' (of runs that came to their end). Return and success are those of the policy that "
        "the run would have kept if it had been stopped then, which is the one that stop_when ranks first of those "
        "evaluated until then. They come from evaluations in training, by which that policy was chosen, not from Table "
        "5's episodes, and are biased upwards. Frames and updates are interpolated between evaluations; a run that "
        "ended sooner keeps its last values. Interquartile means over seeds with 95 % intervals. Wall-clock depends on "
        "the machine and on its other programs.",
        (
            "",
            "seeds evaluated",
            "return, IQM",
            "success, IQM",
            "frames, thousands",
            "updates, thousands",
            "training, min, median",
        ),
        rows,
    )


def robustness_table(groups: Mapping[str, Sequence[Mapping[str, Any]]]) -> Table:
    """Return the table of success under each condition, and the impulse survived at every phase of the stride.

    Args:
        groups: Results of :meth:`.Examination.results` by group.
    """
    conditions = dict.fromkeys(name for results in groups.values() for one in results for name in one["conditions"])
    rows = []
    for name in conditions:
        rates = [
            [one["conditions"][name]["success_rate"] for one in results if name in one["conditions"]]
            for results in groups.values()
        ]
        rows.append([f"success, {name}", "", *(mean_and_range(values, 2) for values in rates)])
    for direction in DIRECTIONS:
        impulses = [[weakest(one, direction) for one in results] for results in groups.values()]
        cells = [mean_and_range([value for value in values if np.isfinite(value)], 1) for values in impulses]
        rows.append([f"push {direction}, worst moment", "N s", *cells])
    perturbations = next(iter(groups.values()))[0]["perturbations"]
    return Table(
        "robustness",
        "Robustness",
        "Mean over seeds (lowest to highest), each by itself, the policy as it was trained. A push's number is the "
        "largest impulse that is survived at every phase of the stride: the robot walks on for "
        f"{perturbations['recover']:g} s, at all {perturbations['starts']} starts, and with every smaller impulse; "
        f"{perturbations['impulses'][-1]:g} N s is the largest that was tried.",
        ("", UNIT, *groups),
        rows,
    )


def runs_table(groups: Mapping[str, Sequence[Run]]) -> Table:
    """Return the table of runs: time, frames, return, success and outcome of each."""
    rows = []
    for group, runs in groups.items():
        for run in runs:
            frames = number(run.rows[-1]["frames"], 0) if run.rows else "-"
            state = "always finishes" if run.value("success_rate") >= 1.0 else "does not always finish"
            state = f"failed: {run.failure}" if run.failure else state
            cells = [number(run.minutes, 1), number(run.minutes_to_finish, 1), frames]
            cells += [number(run.value("return_mean"), 1), number(run.value("success_rate"), 2)]
            rows.append([group, str(run.seed), *cells, f"{run.trouble}; {state}" if run.trouble else state, run.name])
    head = ("", "seed", "minutes", "to finish", "frames", "return", "success", OUTCOME, DIRECTORY)
    note = "Minutes of wall-clock until the last evaluation, and until the first in which every episode finished."
    return Table("runs", "Runs", note, head, rows)


def settings_table(groups: Mapping[str, Sequence[Run]]) -> Table:
    """Return the table of keys of the configuration in which groups differ."""
    firsts = [runs[0] for runs in groups.values()]
    rows = [[key, *map(str, values)] for key, values in differences(firsts).items()]
    return Table("settings", "Where configurations differ", "The seed aside.", ("key", *groups), rows)


def spawn_height(robot: Robot) -> float:
    """Return the height of the robot above standing when an episode begins (m)."""
    nothing = np.zeros(robot.model.nv)
    spawn, standing = (robot.base.read(q, nothing)["height"][0] for q in (robot.start_qpos, robot.standing_qpos))
    return float(spawn - standing)
