"""Compare runs in one page: ``python -m gctd3.report runs=DIR out=DIR``."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import gctd3
from gctd3.comparison.archive import check_keep, keep
from gctd3.comparison.comparability import check_episodes, check_seeds, check_together
from gctd3.comparison.groups import groups_of, typical, with_trace
from gctd3.comparison.output_directory import FIGURES, PAGE, TABLES, VERDICT, check_place, in_place
from gctd3.comparison.runs import Run, evaluated, find_runs, lost_runs
from gctd3.comparison.settings import ReportSettings
from gctd3.errors import ConfigError, RenderError, RunError
from gctd3.evaluation.episode import LAST_METRES
from gctd3.files import title, write_text
from gctd3.robots.own_copy import OwnCopy
from gctd3.robots.robot import Robot
from gctd3.robots.settings import RobotSettings
from gctd3.runs.evaluate import TRACE

if TYPE_CHECKING:
    from gctd3.comparison.figures import Gallery, Picture

NEEDED = ("matplotlib",)


def report(settings: ReportSettings) -> Path:
    """Read the runs, evaluate those that have no evaluation, and write the page, its figures and its tables.

    Returns:
        The path of the page.

    Raises:
        ConfigError: If a package is missing.
        RunError: If there are no runs, they do not belong together, none has a policy, or ``out`` holds something else.
    """
    missing = [package for package in NEEDED if find_spec(package) is None]
    if missing:
        raise ConfigError(f"report needs {', '.join(missing)}: pip install 'gctd3[report]'.")
    root, out = Path(settings.runs), Path(settings.out)
    if settings.keep_runs:
        check_keep(root, out)
    check_place(out, root)
    runs, lost = find_runs(root), lost_runs(root)
    check_together(runs)
    check_seeds(groups_of(runs))
    check_episodes(runs, settings)
    runs = evaluated(runs, settings)
    # Once more, now that the new evaluations have a reward too.
    check_together(runs)
    if all(run.evaluation is None for run in runs):
        raise RunError(f"None of the {len(runs)} runs below {settings.runs} could be evaluated: {runs[0].failure}")
    groups = groups_of(runs)
    with in_place(out) as aside:
        write(groups, aside, lost)
    if settings.keep_runs:
        keep(groups, out, lost)
    return out / PAGE


def write(groups: Mapping[str, Sequence[Run]], out: Path, lost: Sequence[str] = ()) -> None:
    """Write the report of runs by group; see :func:`report`.

    Args:
        groups: Runs by the name of their group.
        out: Directory to write to.
        lost: Names of runs without a configuration.
    """
    # Imported late, so that a wrong setting is answered at once.
    from gctd3.comparison import figures, tables
    from gctd3.comparison.equal_time import time_limit
    from gctd3.comparison.page import page
    from gctd3.comparison.verdict import comparisons, unlike_machines, verdict

    runs = [run for members in groups.values() for run in members]
    config = runs[0].config
    walks = "task.name" not in config
    # From these keys alone, so that runs of other versions can be reported on as long as they have been evaluated.
    keys = ("name", "feet", "forward", "sources", "source", "root", "pose", "hold")
    named = {key: config[f"robot.{key}"] for key in keys if f"robot.{key}" in config}
    asked = RobotSettings(**named)
    robot = _robot(runs, asked) if walks else None
    subject = title(asked.name) if walks else str(config["task.name"])
    gallery = figures.Gallery(out / FIGURES)

    limit = time_limit(groups)
    learning = []
    axes = (("frames", "frames, thousands", 1000.0), ("wall_s", "wall-clock, minutes", 60.0))
    for x, label, scale in (*axes, ("train_episodes", "training episodes", 1.0)):
        at_limit = limit.seconds if limit is not None and x == "wall_s" else None
        figure = figures.curves(groups, x, label, scale, at_limit)
        if figure is not None:
            caption = (
                "Interquartile mean over seeds (their number in brackets) and its 95 % bootstrap interval; a dot where "
                "a run ended; from there on its last value counts."
            )
            if at_limit is not None:
                caption += " Dashed, where the groups are compared at equal wall-clock."
            learning.append(gallery.add(figure, f"curve_{x}", f"Return over {label}", caption))

    pictures = [
        gallery.add(
            figures.performance(groups),
            "performance_profile",
            "Performance profile",
            "For each return, the share of runs that do better, with its 95 % interval.",
        )
    ]
    chances = figures.improvements(groups)
    if chances is not None:
        caption = "With its 95 % interval; at 0.5, dashed, neither is ahead."
        pictures.append(gallery.add(chances, "improvement", "Probability of improvement", caption))

    if any(typical(with_trace(members)) for members in groups.values()):
        caption = "The typical episode of the run with the group's median return."
        pictures.append(gallery.add(figures.body_height(groups), "body_height", "Body height", caption))

    table5 = tables.table5(groups, robot, walks and asked.name == "biped")
    sections: list[tuple[str, list[object]]] = [
        ("Learning", [*learning]),
        ("Table 5", [table5, *pictures]),
        ("Equal wall-clock", [tables.equal_time(groups, limit), *unlike_machines(groups)] if limit is not None else []),
        ("Gait", [*_gaits(groups), *(_gait_pictures(groups, robot, gallery) if robot is not None else [])]),
        ("Robustness", _robustness(groups, gallery)),
        ("Runs", [tables.runs_table(groups)]),
        ("Settings", [tables.settings_table(groups)] if len(groups) > 1 else []),
    ]
    compared = comparisons(groups, limit) if len(groups) > 1 else []
    table = tables.comparisons_table(compared) if compared else None
    for thing in [table, *(thing for _, things in sections for thing in things)]:
        if isinstance(thing, tables.Table):
            (out / TABLES).mkdir(parents=True, exist_ok=True)
            write_text(out / TABLES / f"{thing.name}.csv", thing.csv())
    sentences = verdict(groups, lost)
    about = f"{len(runs)} runs in {len(groups)} group{'s' * (len(groups) != 1)}, gctd3 {gctd3.__version__}."
    write_text(out / PAGE, page(f"{subject}: {', '.join(groups)}", about, sentences, sections, table))
    write_text(out / VERDICT, "\n".join(sentences) + "\n")


def _robot(runs: Sequence[Run], asked: RobotSettings) -> Robot:
    """Return the robot of runs: the first whole copy that one of them keeps, or else what its source is now."""
    copies = (OwnCopy.read(run.directory) for run in runs)
    kept = next((copy for copy in copies if copy is not None and copy.present), None)
    return asked.load() if kept is None else kept.robot


def _gaits(groups: Mapping[str, Sequence[Run]]) -> list[object]:
    from gctd3.comparison.gaits import gaits

    table = gaits(groups)
    return [table if table.rows else f"No episode got {LAST_METRES:.0f} m far, so there is no gait to measure."]


def _gait_pictures(groups: Mapping[str, Sequence[Run]], robot: Robot, gallery: Gallery) -> list[object]:
    """Return for each group notes on missing pictures, and a row: filmstrip, joints, phase portraits, contacts."""
    from gctd3.comparison.filmstrips import stride_of
    from gctd3.comparison.page import Row

    items: list[object] = []
    for group, runs in groups.items():
        run = typical(runs)
        if run is None:
            continue
        notes, films = [], []
        try:
            frames, what, caption = stride_of(run)
            title = f"{group}, seed {run.seed}: {what}"
            films.append(gallery.add_film(frames, f"film_{_file(group)}", title, caption))
        except RenderError as error:
            notes.append(f"{group}: no filmstrip. {error}")
        contacts, others, lacking = _traces(group, typical(with_trace(runs)), robot, gallery)
        items += [*notes, *lacking, Row([[picture] for picture in (*others, *contacts)], films)]
    return items


def _traces(
    group: str, run: Run | None, robot: Robot, gallery: Gallery
) -> tuple[list[Picture], list[Picture], list[str]]:
    """Return pictures of the contacts, pictures of joints and phase portraits, and a note if the trace is missing."""
    from gctd3.comparison import figures

    if run is None or run.trace is None:
        lacking = f"{group}: no joint traces and no contacts, for its runs have no {TRACE}; evaluate them again for it."
        return [], [], [lacking]
    others, whose, i = [], f"{group}, seed {run.seed}", _file(group)
    late = f"The end of the episode, at most {figures.SECONDS:g} s."
    if figures.joint_pairs(robot):
        figure = figures.joint_traces(run.trace, robot)
        others.append(gallery.add(figure, f"joints_{i}", f"{whose}: joints, right against left", late))
        figure = figures.phase_portraits(run.trace, robot)
        caption = f"The last {figures.STRIDES_SECONDS:g} s at most; one closed loop is a motion that repeats."
        others.append(gallery.add(figure, f"phase_{i}", f"{whose}: phase portraits", caption))
    figure = figures.contacts(run.trace, robot)
    return [gallery.add(figure, f"contacts_{i}", f"{whose}: feet on the ground", late)], others, []


def _file(group: str) -> str:
    return re.sub(r"\W+", "_", group)


def _robustness(groups: Mapping[str, Sequence[Run]], gallery: Gallery) -> list[object]:
    from gctd3.comparison import tables
    from gctd3.viz import robustness_plot

    examined = {group: [r.robustness for r in runs if r.robustness] for group, runs in groups.items()}
    examined = {group: results for group, results in examined.items() if results}
    if not examined:
        return []
    items: list[object] = [tables.robustness_table(examined)]
    figure = robustness_plot.conditions_figure(examined)
    caption = "The mean over seeds; a stroke for each seed."
    items.append(gallery.add(figure, "conditions", "Success under other conditions", caption))
    pushes = robustness_plot.pushes_figure(examined)
    if pushes is not None:
        caption = (
            "The largest impulse on the body up to which all starts survive; the mean over seeds. Solid "
            "forward, dashed backward."
        )
        items.append(gallery.add(pushes, "pushes", "Pushes survived over the stride", caption))
    return items
