"""The report's table of gaits: every metric with its definition, by group."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from gctd3.comparison.cells import Cell, count, mean_and_range
from gctd3.comparison.runs import Run
from gctd3.comparison.tables import MEANING, UNIT, Table
from gctd3.comparison.verdict import scores
from gctd3.evaluation.gait_metrics import circular_mean
from gctd3.evaluation.summary import why_missing

# Key, name, unit, decimals, definition.
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
    ("periodic_fraction", "periodic", "", 2, "share of episodes whose strides could be evaluated"),
)
ASYMMETRY = "asymmetry_"


def gaits(groups: Mapping[str, Sequence[Run]]) -> Table:
    """Return the table of gait metrics with their definitions: mean, lowest and highest over seeds; no empty rows."""
    keys = sorted({key for runs in groups.values() for run in runs for key in run.gait if key.startswith(ASYMMETRY)})
    meaning = "RMS against its mirror image half a stride later; 0 is symmetric"
    joints = [(key, f"asymmetry, {key.removeprefix(ASYMMETRY).replace('_', ' ')}", "rad", 3, meaning) for key in keys]
    counts = [count(sum(bool(run.gait) for run in runs), len(runs)) for runs in groups.values()]
    evaluated = ["seeds evaluated here", "", *counts, "seeds with an episode that got 10 m far"]
    rows = []
    for key, name, unit, digits, meaning in (*GAIT, *joints):
        cells = [_gait_cell(runs, key, digits) for runs in groups.values()]
        if any(cell != "-" for cell in cells):
            rows.append([name, unit, *cells, meaning])
    return Table(
        "gait",
        "Gaits",
        "Over the last 10 m of the episodes that got that far: mean over seeds (lowest to highest). Metrics of strides "
        "cover the seeds with strides in at least half of these episodes.",
        ("", UNIT, *groups, MEANING),
        [evaluated, *rows] if rows else [],
    )


def _gait_cell(runs: Sequence[Run], key: str, digits: int) -> Cell:
    """Return a metric's mean over seeds and range, and how many seeds lack it, with the reason."""
    known = scores(runs, key)
    if key == "phase_offset" and known:
        # Phases go round: 0.98 and 0.02 are neighbours.
        mean = circular_mean(known)
        known = [mean + (phase - mean + 0.5) % 1.0 - 0.5 for phase in known]
    gaits = [run.gait for run in runs]
    lacking = Counter(why_missing(gait, key) for gait in gaits if key in gait and gait[key] is None)
    reasons = [f"{seeds} {why}" for why, seeds in lacking.items()]
    cell = mean_and_range(known, digits)
    if not reasons:
        return cell
    return Cell("; ".join([*([cell] if known else []), *reasons]), {**cell.numbers, "lacking": "; ".join(reasons)})
