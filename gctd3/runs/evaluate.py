"""Evaluate a policy: ``python -m gctd3.evaluate run=DIR episodes=50``."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from gctd3.envs.factory import build_env
from gctd3.errors import RunError
from gctd3.evaluation.command_grid import examine
from gctd3.evaluation.episode import LAST_METRES, Episode
from gctd3.evaluation.jumping import by_level
from gctd3.evaluation.quantities import quantity
from gctd3.evaluation.robustness import Examination
from gctd3.evaluation.rollout import evaluate
from gctd3.evaluation.summary import OF_STRIDES, summarize, why_missing
from gctd3.files import check_writable, made, new_file, quoted, unwritable, write_text
from gctd3.progress import StatusLine
from gctd3.robots.robot import Robot
from gctd3.runs.settings import EvaluateSettings
from gctd3.tasks.task import check_able

PAPERS_ROBOT = "biped"
# Table 5 of the paper, column GCTD3. Its body position seems to count from the spawn height, 0.0235 m above standing.
PAPER = {"return_mean": 380.0, "return_std": 18.47, "velocity_mean": 1.414, "body_position_mean": -0.0202}
EVALUATION, TRACE = "evaluation.json", "trace.csv"
ROBUSTNESS, ROBUSTNESS_PICTURE = "robustness.json", "robustness.png"
COMMANDS, COMMANDS_PICTURE = "commands.json", "commands.png"


@dataclass(frozen=True)
class Measured:
    """Hold the result of an evaluation.

    Attributes:
        report: The report in ``evaluation.json``.
        typical: The typical episode, with its motion; ``None`` for a task that cannot be filmed.
        robot: The robot.
        control_dt: Control period (s).
    """

    report: dict[str, object]
    typical: Episode | None
    robot: Robot
    control_dt: float

    @property
    def trace(self) -> str | None:
        """Return the motion of the typical episode as CSV, if it was recorded."""
        return None if self.typical is None else trace(self.typical, self.robot, self.control_dt)


def evaluate_run(settings: EvaluateSettings) -> dict[str, object]:
    """Evaluate the best policy of a run; write ``evaluation.json`` and ``trace.csv`` to ``settings.folder``, if any.

    Returns:
        The report in ``evaluation.json``.

    Raises:
        OSError: If they cannot be written.
        RunError: If the directory is not a run, one of another version, or of a task that robustness is not for.
    """
    with made(settings.folder):
        measured = measure_run(settings)
        write_evaluation(settings.folder, measured)
    return measured.report


def where_to_write(settings: EvaluateSettings) -> tuple[Path | None, str | None]:
    """Check, before a simulation that may be long, that its results can be written.

    Returns:
        The folder, ``None`` to write nothing; and, where the run's own cannot be written to, a line that says so.

    Raises:
        RunError: If ``out`` asks for a folder that cannot be written to.
    """
    if settings.bag is not None:
        check_writable(Path(settings.bag))
    folder = settings.folder
    reason = unwritable(folder) if folder is not None else None
    if reason is None:
        return folder, None
    if settings.out is not None:
        raise RunError(f"out={settings.out} cannot be written to: {reason}.")
    return None, f"Nothing is written to {folder}: {reason}. out=DIR writes elsewhere."


def where_written(folder: Path | None, names: Sequence[str]) -> str:
    """Return a line that tells where the files of an evaluation were written.

    Args:
        folder: Folder of the files; ``None`` if nothing was written.
        names: Names of the files, which need not all be there.
    """
    if folder is None:
        return "Nothing is written for the policy that ships with gctd3: out=DIR writes, and run=DIR to that run."
    return f"Written to {' and '.join(quoted(folder / name) for name in names if (folder / name).is_file())}"


def write_evaluation(folder: Path | None, measured: Measured) -> None:
    """Write what :func:`measure_run` returned to a folder, if one is given.

    Raises:
        OSError: If it cannot be written.
    """
    if folder is None:
        return
    folder.mkdir(parents=True, exist_ok=True)
    motion = measured.trace
    if motion is not None:
        write_text(folder / TRACE, motion)
    write_text(folder / EVALUATION, json.dumps(measured.report, indent=2) + "\n")


def measure_run(settings: EvaluateSettings) -> Measured:
    """Evaluate the best policy of a run, and write nothing.

    Raises:
        RunError: If the directory is not a run, one of another version, or of a task that robustness is not for.
    """
    from gctd3.runs.load import load_run
    from gctd3.training.checkpoint import versions

    run = load_run(settings.run)
    if settings.robustness:
        check_able(run.setup.task, "robustness", run.directory)
    if settings.commands:
        check_able(run.setup.task, "commands", run.directory)
    if settings.bag is not None:
        check_able(run.setup.task, "film", run.directory)
    policy = run.policy()
    reward = settings.reward or run.settings.evaluation.reward
    task = run.setup.task.evaluated(reward)
    env = build_env(task, run.settings.env.for_evaluation(settings.episodes, settings.threads), settings.seed)
    walks, dt = "film" in task.abilities, task.control_dt
    with StatusLine() as line:
        result = evaluate(policy, env, task, settings.seed, record=walks, line=line)
    robot = task.robot.path.stem
    about: dict[str, object] = {"robot": robot, "reward": reward.to_dict()} if walks else {"task": task.name}
    report: dict[str, object] = {
        **about,
        **result.summary(),
        "gait": {**result.gait(), **(summarize(result.episodes, task.robot, dt) if walks else {})},
        **({"ground": grounds} if (grounds := result.by_ground()) else {}),
        **({"jumps": [asdict(level) for level in levels]} if (levels := by_level(result.episodes)) else {}),
        "seeds": {"training": run.settings.seed, "evaluation": settings.seed},
        "versions": versions(),
    }
    report = {key: _finite(value) for key, value in report.items()}
    return Measured(report, result.typical if walks else None, task.robot, dt)


def examine_run(settings: EvaluateSettings, stride_time: float | None) -> dict[str, Any]:
    """Test the robustness of a run's best policy, and write nothing.

    Args:
        settings: The settings, as for :func:`evaluate_run`.
        stride_time: Stride time of its gait (s), if it has strides.

    Returns:
        The results, see :meth:`.Examination.results`.

    Raises:
        RunError: If it is not a run, or one of a task that robustness is not for.
    """
    from gctd3.runs.load import load_run
    from gctd3.training.checkpoint import versions

    run = load_run(settings.run)
    reward = settings.reward or run.settings.evaluation.reward
    task = run.task("robustness", reward)
    env = run.settings.env.for_evaluation(settings.episodes, settings.threads)
    examination = Examination(run.policy(), task, env, settings.seed, settings.perturbations)
    return {**examination.results(stride_time), "reward": reward.to_dict(), "versions": versions()}


def write_robustness(folder: Path | None, results: dict[str, Any]) -> None:
    """Write the results of :func:`examine_run` to a folder, if one is given; with matplotlib a picture too.

    Raises:
        OSError: If they cannot be written.
    """
    if folder is None:
        return
    write_text(folder / ROBUSTNESS, json.dumps(_finite(results), indent=1) + "\n")
    if find_spec("matplotlib") is not None:
        from gctd3.viz import robustness_plot

        with new_file(folder / ROBUSTNESS_PICTURE) as aside:
            robustness_plot.save(results, aside)


def command_run(settings: EvaluateSettings) -> dict[str, Any]:
    """Test a run's best policy with a grid of commands, and write nothing.

    Args:
        settings: The settings, as for :func:`evaluate_run`.

    Returns:
        The results, see :func:`.command_grid.examine`.

    Raises:
        RunError: If it is not a run, or not one of commanded velocities.
    """
    from gctd3.runs.load import load_run
    from gctd3.training.checkpoint import versions

    run = load_run(settings.run)
    task = run.task("commands")
    env = run.settings.env.for_evaluation(settings.episodes, settings.threads)
    return {**examine(run.policy(), task, env, settings.seed, settings.grid), "versions": versions()}


def write_commands(folder: Path | None, results: dict[str, Any]) -> None:
    """Write the results of :func:`command_run` to a folder, if one is given; with matplotlib a picture too.

    Raises:
        OSError: If they cannot be written.
    """
    if folder is None:
        return
    write_text(folder / COMMANDS, json.dumps(results, indent=1) + "\n")
    if find_spec("matplotlib") is not None:
        from gctd3.viz import command_plot

        with new_file(folder / COMMANDS_PICTURE) as aside:
            command_plot.save(results, aside)


def trace(episode: Episode, robot: Robot, dt: float) -> str:
    """Format the recorded motion of an episode as CSV, a row for each control step, units in the head.

    Raises:
        ValueError: If its motion was not recorded.
    """
    motion = episode.motion
    if motion is None:
        raise ValueError("The episode's motion was not recorded; evaluate(..., record=True) does.")
    names = [joint.name for joint in robot.joints]
    head = ["time_s", "position_m", "height_m", "velocity_m_s"]
    head += [f"angle_{name}_rad" for name in names] + [f"velocity_{name}_rad_s" for name in names]
    head += [f"down_{foot}" for foot in robot.feet]
    time = dt * np.arange(1, len(episode.position) + 1)
    columns = [time, episode.position, episode.height, motion.velocity, *motion.angles.T, *motion.velocities.T]
    rows = zip(*columns, *episode.feet_down.T.astype(int), strict=True)
    text = io.StringIO()
    # Names may hold commas and quotes.
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows([f"{value:.6g}" for value in row] for row in rows)
    return text.getvalue()


def table(report: dict[str, object]) -> str:
    """Format the report as a table, of a walk beside the paper's row."""
    rows = [("episodes", "episodes", "{:.0f}", None), ("return", "return_mean", "{:.1f}", "return_std")]
    walk = "task" not in report
    # The robot of a library's task may be fixed where it is.
    if walk or report["distance_mean"]:
        rows += [("velocity, m/s", "velocity_mean", "{:.3f}", None), ("distance, m", "distance_mean", "{:.2f}", None)]
    if "error_forward" in report:
        rows += [
            ("commands followed", "followed_rate", "{:.0%}", None),
            ("error forward, m/s", "error_forward", "{:.3f}", None),
            ("error to the side, m/s", "error_side", "{:.3f}", None),
            ("error of the yaw rate, rad/s", "error_turn", "{:.3f}", None),
            ("share of falls", "fall_rate", "{:.2f}", None),
        ]
    elif "apex_error" in report:
        rows += [
            ("success rate", "success_rate", "{:.2f}", None),
            ("share of falls", "fall_rate", "{:.2f}", None),
            ("apex, m", "apex_mean", "{:.3f}", None),
            ("apex off the commanded height, m", "apex_error", "{:.3f}", None),
        ]
    elif walk:
        rows += [
            ("success rate", "success_rate", "{:.2f}", None),
            ("body position, m from standing", "body_position_mean", "{:.4f}", None),
        ]
    # The paper has no numbers for a library's task, nor for another robot than its biped.
    compared = (
        walk
        and not {"error_forward", "apex_error"} & report.keys()
        and report.get("robot", PAPERS_ROBOT) == PAPERS_ROBOT
    )
    lines = [f"{'':34}{'this policy':>18}" + (f"{'paper, GCTD3':>18}" if compared else "")]

    def cell(values: dict[str, object], key: str, form: str, spread: str | None) -> str:
        if key not in values:
            return "-"
        if values[key] is None:
            return "undefined"
        text = form.format(values[key])
        return f"{text} ± {form.format(values[spread])}" if spread else text

    paper: dict[str, object] = {**PAPER, "episodes": 50}
    for label, key, form, spread in rows:
        beside = f"{cell(paper, key, form, spread):>18}" if compared else ""
        lines.append(f"{label:34}{cell(report, key, form, spread):>18}{beside}")
    lines += ground_table(report) + jump_table(report)
    gait = report["gait"]
    if not walk and not gait:
        return "\n".join(lines)
    if not isinstance(gait, dict) or not gait:
        if "jumps" in report:
            return "\n".join(lines)
        return "\n".join([*lines, f"No episode got {LAST_METRES:.0f} m far, so there is no gait to measure."])
    lines += ["", f"Gait over the last {LAST_METRES:.0f} m of {gait['episodes']:.0f} episodes"]
    for key, value in gait.items():
        if key != "episodes":
            text = f"{value:.4g}" if value is not None else why_missing(gait, key) if key in OF_STRIDES else "undefined"
            lines.append(f"{quantity(key).title:34}{text:>18}")
    return "\n".join(lines)


def ground_table(report: Mapping[str, object]) -> list[str]:
    """Return the lines of the results on each kind and level of terrain; none on a plane."""
    rows = report.get("ground")
    if not isinstance(rows, list) or not rows:
        return []
    lines = ["", f"{'ground':24}{'level':>6}{'episodes':>10}{'success':>9}{'falls':>7}{'distance, m':>13}"]
    form = "{kind:24}{level:>6}{episodes:>10}{success_rate:>9.2f}{fall_rate:>7.2f}{distance_mean:>13.2f}"
    return lines + [form.format(**row) for row in rows]


def jump_table(report: Mapping[str, object]) -> list[str]:
    """Return the lines of the results at each commanded height; none for a task without jumps."""
    rows = report.get("jumps")
    if not isinstance(rows, list) or not rows:
        return []
    lines = ["", f"{'commanded, m':14}{'episodes':>10}{'success':>9}{'falls':>7}{'apex, m':>10}{'least':>8}{'most':>8}"]
    form = "{commanded:<14.3f}{episodes:>10}{success_rate:>9.2f}{fall_rate:>7.2f}{apex_mean:>10.3f}"
    form += "{apex_least:>8.3f}{apex_most:>8.3f}"
    return lines + [form.format(**row) for row in rows]


def _finite(value: object) -> object:
    """Replace undefined numbers in ``value`` by ``None``, which JSON can hold as ``null``."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value
