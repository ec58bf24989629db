"""The report's tables: the paper's Table 5 beside ours, the gaits, the runs, what their configurations differ in."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gctd3.gait_metrics import circular_mean
from gctd3.gait_summary import why_missing
from gctd3.reporting.clock import Limit, reached_by
from gctd3.reporting.groups import differences
from gctd3.reporting.runs import Run
from gctd3.reporting.statistics import interval
from gctd3.reporting.verdict import scores
from gctd3.robot import Robot
from gctd3.robustness import DIRECTIONS, weakest

# Table 5: return and its standard deviation over 50 episodes, body position (m), velocity (m/s).
PAPER = {
    "ddpg": (241.28, 89.44, -0.0114, 1.344),
    "sac": (224.18, 56.96, -0.0397, 0.619),
    "td3": (370.31, 37.26, -0.0020, 1.164),
    "gctd3": (380.0, 18.47, -0.0202, 1.414),
}
# Key, name, unit, decimals, what it is.
GAIT = (
    ("hip_correlation", "hip correlation", "", 2, "of right and left hip angle; -1 when legs take turns"),
    ("stride_frequency", "stride frequency", "Hz", 2, "one over the stride time"),
    ("stride_time", "stride time", "s", 2, "median from a foot's touchdown to its next, bounces left out"),
    ("stride_variation", "stride variation", "", 3, "standard deviation of stride times over their mean"),
    ("regularity", "regularity", "", 3, "autocorrelation of the joint angles after a stride; 1 repeats exactly"),
    ("duty_factor", "duty factor", "", 2, "contact time over stride time; above 0.5 it walks, below it runs"),
    ("phase_offset", "phase offset", "", 2, "when the left foot touches down in the right one's stride; ideal 0.5"),
    ("duty_symmetry", "duty symmetry", "%", 1, "(right - left) / mean of duty factors (Herzog 1989); ideal 0"),
    ("step_symmetry", "step symmetry", "%", 1, "the same of the times from foot to foot; ideal 0"),
    ("flight_fraction", "flight", "", 2, "share of time with no foot down"),
    ("double_support_fraction", "double support", "", 2, "share of time with more than one foot down"),
    ("foot_clearance", "foot clearance", "m", 3, "sole above the ground in the middle of a swing"),
    ("slip_speed", "slip", "m/s", 3, "mean speed over the ground of soles that are down"),
    ("height_rms", "height RMS", "m", 3, "of the body's height about its mean"),
    ("froude", "Froude number", "", 2, "v² / (g L), L the hip's height when standing"),
    ("cost_of_transport", "cost of transport", "", 2, "Σ|τω|Δt / (m g d), braking costs as driving does"),
    ("cost_of_transport_positive", "cost of transport, positive", "", 2, "the same of driving alone"),
    ("torque_saturation", "torque saturation", "%", 1, "share of time at the servos' limit, over all servos"),
    ("action_rate", "action rate", "1/s", 1, "RMS of the actions' first difference over dt"),
    ("action_jerk", "action jerk", "1/s³", 0, "RMS of their third difference over dt³"),
    ("action_smoothness", "action smoothness", "", 4, "mean of amplitude times frequency (Mysore 2021); low is smooth"),
    (
        "floquet_max",
        "largest Floquet multiplier",
        "",
        2,
        "of the touchdown map, from below; under 1 is stable",
    ),
    ("strides", "strides used", "", 0, "of all feet and episodes; the first two of each foot are never used"),
    ("periodic_fraction", "periodic", "", 2, "share of episodes whose strides could be judged"),
)
ASYMMETRY = "asymmetry_"
# Columns that a page does not treat as numbers.
UNIT, MEANING, OUTCOME, DIRECTORY = "unit", "what it is", "outcome", "directory"


@dataclass(frozen=True)
class Table:
    """Rows of texts under a head.

    Attributes:
        name: Of its file.
        title: Above it.
        note: Below it.
        head: Names of the columns.
        rows: Cells.
    """

    name: str
    title: str
    note: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]

    def csv(self) -> str:
        """As the text of a CSV file."""
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([self.head, *self.rows])
        return text.getvalue()


def table5(groups: Mapping[str, Sequence[Run]], robot: Robot | None, is_biped: bool) -> Table:
    """Return, body position from both references, velocity and success, the paper's rows beside ours.

    Args:
        groups: The runs.
        robot: Theirs; ``None`` of another library's task, whose body position then counts from nothing known.
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
                f"{len(means)} of {len(runs)}",
                _spread(means, 1),
                interval(means).text(1),
                _mean(body, 4),
                _mean([value - drop for value in body if np.isfinite(drop)], 4),
                interval(speed).text(3),
                _mean(won, 2),
            ]
        )
        algorithm = runs[0].algorithm
        if is_biped and algorithm in PAPER and not any(row[0] == f"paper, {algorithm.upper()}" for row in rows):
            mean, deviation, position, velocity = PAPER[algorithm]
            row = [f"paper, {algorithm.upper()}", "-", f"{mean} ± {deviation}", "-", "-", f"{position:.4f}"]
            rows.append([*row, f"{velocity:.3f}", "-"])
    return Table(
        "table5",
        "The paper's Table 5",
        f"Ours: mean ± standard deviation over seeds, each the mean of its {_episodes(groups)}; IQM is the "
        "interquartile mean over seeds with its 95 % interval. The paper's ± is over 50 episodes of one training, in "
        "another simulator: not like for like. Its body position seems to count from the height at which the robot is "
        "dropped" + (f", {drop:.4f} m above standing." if np.isfinite(drop) else "."),
        (
            "",
            "seeds judged",
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
    """As ``50 episodes``; a report has as many for all runs."""
    found = {run.evaluation.get("episodes") for runs in groups.values() for run in runs if run.evaluation}
    return f"{found.pop()} episodes" if len(found) == 1 and None not in found else "episodes"


def equal_time(groups: Mapping[str, Sequence[Run]], limit: Limit) -> Table:
    """Return, success, frames and updates that each group had reached at ``limit``."""
    columns = (("return_mean", 1.0, 1), ("success_rate", 1.0, 2), ("frames", 1e-3, 1), ("updates", 1e-3, 1))
    rows = []
    for group, known in reached_by(groups, limit.seconds).items():
        cells = [interval([scale * getattr(one, key) for one in known]) for key, scale, _ in columns]
        said = [cell.text(column[-1]) if known else "-" for cell, column in zip(cells, columns, strict=True)]
        seeds = f"{len(known)} of {len(groups[group])}"
        rows.append([group, seeds, *said, _number(limit.medians[group] / 60.0, 2)])
    return Table(
        "equal_time",
        "At equal wall-clock",
        f"What each run had reached after {limit.text} of wall-clock: the median training time of {limit.group}, the "
        "shortest of all groups' (of runs that came to their end). Return and success are those of the policy that "
        "the run would have kept if it had been stopped then, which is the one that stop_when ranks first of those "
        "evaluated until then. They are of evaluations in training, by which that policy was chosen: not of Table 5's "
        "episodes, and rather too high. Frames and updates are interpolated between evaluations; a run that ended "
        "sooner stays as it was. Interquartile means over seeds with 95 % intervals. Wall-clock depends on the machine "
        "and on what else ran there.",
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


def gaits(groups: Mapping[str, Sequence[Run]]) -> Table:
    """Every gait metric with its definition: mean over seeds, and the lowest and the highest."""
    keys = sorted({key for runs in groups.values() for run in runs for key in _gait(run) if key.startswith(ASYMMETRY)})
    meaning = "RMS against its mirror image half a stride later; 0 is symmetric"
    joints = [(key, f"asymmetry, {key.removeprefix(ASYMMETRY).replace('_', ' ')}", "rad", 3, meaning) for key in keys]
    far = [f"{sum(bool(_gait(run)) for run in runs)} of {len(runs)}" for runs in groups.values()]
    rows = [["seeds judged here", "", *far, "those of whose episodes any got 10 m far"]]
    for key, name, unit, digits, meaning in (*GAIT, *joints):
        cells = [_gait_cell(runs, key, digits) for runs in groups.values()]
        if any(cell != "-" for cell in cells):
            rows.append([name, unit, *cells, meaning])
    return Table(
        "gait",
        "Gaits",
        "Over the last 10 m of the episodes that got that far: mean over seeds (lowest to highest). What only strides "
        "have is given of seeds at least half of whose episodes have them.",
        ("", UNIT, *groups, MEANING),
        rows,
    )


def robustness_table(groups: Mapping[str, Sequence[Mapping[str, Any]]]) -> Table:
    """Success under each condition, and the impulse survived at every phase of the stride.

    Args:
        groups: Results of :meth:`.Examination.results` by group.
    """
    conditions = dict.fromkeys(name for results in groups.values() for one in results for name in one["conditions"])
    rows = []
    for name in conditions:
        found = [
            [one["conditions"][name]["success_rate"] for one in results if name in one["conditions"]]
            for results in groups.values()
        ]
        rows.append([f"success, {name}", "", *(_range(values, 2) for values in found)])
    for direction in DIRECTIONS:
        impulses = [[weakest(one, direction) for one in results] for results in groups.values()]
        cells = [_range([value for value in values if np.isfinite(value)], 1) for values in impulses]
        rows.append([f"shove {direction}, worst moment", "N s", *cells])
    perturbations = next(iter(groups.values()))[0]["perturbations"]
    return Table(
        "robustness",
        "Robustness",
        "Mean over seeds (lowest to highest), each by itself, the policy as it was trained. A shove's number is the "
        "largest impulse that is survived whenever in the stride it comes: the robot goes on for "
        f"{perturbations['recover']:g} s, at all {perturbations['starts']} starts, and with every smaller impulse; "
        f"{perturbations['impulses'][-1]:g} N s is the largest that was tried.",
        ("", UNIT, *groups),
        rows,
    )


def runs_table(groups: Mapping[str, Sequence[Run]]) -> Table:
    """A row for each run: time, steps, and how it went."""
    rows = []
    for group, runs in groups.items():
        for run in runs:
            frames = f"{run.rows[-1]['frames']:,.0f}" if run.rows else "-"
            state = "always finishes" if run.value("success_rate") >= 1.0 else "does not always finish"
            state = f"failed: {run.failure}" if run.failure else state
            cells = [_number(run.minutes, 1), _number(run.minutes_to_finish, 1), frames]
            cells += [_number(run.value("return_mean"), 1), _number(run.value("success_rate"), 2)]
            rows.append([group, str(run.seed), *cells, f"{run.trouble}; {state}" if run.trouble else state, run.name])
    head = ("", "seed", "minutes", "to finish", "frames", "return", "success", OUTCOME, DIRECTORY)
    note = "Minutes of wall-clock until the last evaluation, and until the first in which every episode finished."
    return Table("runs", "Runs", note, head, rows)


def settings_table(groups: Mapping[str, Sequence[Run]]) -> Table:
    """Keys of the configuration in which groups differ."""
    firsts = [runs[0] for runs in groups.values()]
    rows = [[key, *map(str, values)] for key, values in differences(firsts).items()]
    return Table("settings", "Where configurations differ", "The seed aside.", ("key", *groups), rows)


def spawn_height(robot: Robot) -> float:
    """How far above standing the robot is when an episode begins (m)."""
    nothing = np.zeros(robot.model.nv)
    spawn, standing = (robot.base.read(q, nothing)["height"][0] for q in (robot.start_qpos, robot.standing_qpos))
    return float(spawn - standing)


def _gait_cell(runs: Sequence[Run], key: str, digits: int) -> str:
    """Mean over seeds and range of a metric, and how many seeds lack it for want of strides."""
    known = scores(runs, key)
    if key == "phase_offset" and known:
        # Phases go round: 0.98 and 0.02 are neighbours.
        mean = circular_mean(known)
        known = [mean + (phase - mean + 0.5) % 1.0 - 0.5 for phase in known]
    gaits = [_gait(run) for run in runs]
    lacking = Counter(why_missing(gait, key) for gait in gaits if key in gait and gait[key] is None)
    said = [_range(known, digits)] if known or not lacking else []
    return "; ".join(said + [f"{count} {why}" for why, count in lacking.items()])


def _gait(run: Run) -> Mapping[str, float | None]:
    return (run.evaluation or {}).get("gait") or {}


def _number(value: float, digits: int) -> str:
    return f"{value:,.{digits}f}" if np.isfinite(value) else "-"


def _mean(values: Sequence[float], digits: int) -> str:
    return f"{np.mean(values):.{digits}f}" if len(values) else "-"


def _spread(values: Sequence[float], digits: int) -> str:
    if not len(values):
        return "-"
    mean = f"{np.mean(values):.{digits}f}"
    return f"{mean} ± {np.std(values, ddof=1):.{digits}f}" if len(values) > 1 else mean


def _range(values: Sequence[float], digits: int) -> str:
    if not len(values):
        return "-"
    mean = f"{np.mean(values):,.{digits}f}"
    return f"{mean} ({min(values):,.{digits}f} to {max(values):,.{digits}f})" if len(values) > 1 else mean
