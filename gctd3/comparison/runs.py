"""Runs below a directory: their configurations, how they ended, and their evaluations."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from gctd3.errors import GCTD3Error, RunError
from gctd3.evaluation.settings import EpisodeSettings
from gctd3.files import MANIFEST, OWN_ROBOT, check_regular, read_manifest, unwritable
from gctd3.progress import tracked
from gctd3.runs.evaluate import EVALUATION, ROBUSTNESS, TRACE, evaluate_run
from gctd3.runs.settings import EvaluateSettings
from gctd3.training.post_mortem import POST_MORTEM
from gctd3.training.run_log import PROGRESS
from gctd3.training.saved_configuration import CONFIG, OVERRIDES, command_line, flat, load_config, load_settings
from gctd3.training.stop_when import StopWhen

# All files that are read of a run, except its policy.
READ = (CONFIG, OVERRIDES, *map(Path, (PROGRESS, EVALUATION, TRACE, ROBUSTNESS)), Path(POST_MORTEM) / MANIFEST)
READ += (Path(OWN_ROBOT) / MANIFEST,)


@dataclass(frozen=True)
class Run:
    """Hold the records of one training and its evaluation.

    Attributes:
        directory: Directory of the run.
        name: Its path below the directory that is reported on.
        config: Its configuration by dotted key.
        algorithm: The option of ``algo`` that it was started with.
        rows: Its evaluations in training, as in ``progress.csv``; undefined values are left out.
        evaluation: Content of its ``evaluation.json``.
        trace: Columns of its ``trace.csv``.
        robustness: Content of its ``robustness.json``.
        failure: Reason why it could not be evaluated.
        trouble: Reason why its training did not come to its end.
        overrides: The command line that it was started with, by key.
        robot_hash: Hash of the physics of its robot; ``None`` of a run that does not keep it.
    """

    directory: Path
    name: str
    config: Mapping[str, Any]
    algorithm: str
    rows: Sequence[Mapping[str, float]] = ()
    evaluation: Mapping[str, Any] | None = None
    trace: Mapping[str, np.ndarray] | None = None
    robustness: Mapping[str, Any] | None = None
    failure: str | None = None
    trouble: str | None = None
    overrides: Mapping[str, str] = field(default_factory=dict)
    robot_hash: str | None = None

    @property
    def seed(self) -> int:
        """Return the seed of the training."""
        return int(self.config.get("seed", 0))

    @property
    def minutes(self) -> float:
        """Return the minutes from the beginning of the training to its last evaluation; NaN without evaluations."""
        return self.rows[-1].get("wall_s", math.nan) / 60.0 if self.rows else math.nan

    @property
    def minutes_to_finish(self) -> float:
        """Return the minutes until the first evaluation in which every episode reached the finish, else NaN."""
        return self.finished[0].get("wall_s", math.nan) / 60.0 if self.finished else math.nan

    @property
    def finished(self) -> list[Mapping[str, float]]:
        """Return the evaluations in training in which every episode reached the finish."""
        return [row for row in self.rows if row.get("success_rate", 0.0) >= 1.0]

    @property
    def rule(self) -> StopWhen:
        """Return the rule by which the run ranked its policies."""
        at_least, at_most = (
            {
                key.rpartition(".")[2]: value
                for key, value in self.config.items()
                if key.startswith(f"stop_when.{side}.")
            }
            for side in ("at_least", "at_most")
        )
        return StopWhen(at_least, at_most)

    @property
    def gait(self) -> Mapping[str, float | None]:
        """Return the gait metrics of the evaluation; empty if it has none."""
        return (self.evaluation or {}).get("gait") or {}

    def value(self, key: str) -> float:
        """Return a number of the evaluation, else of its gait metrics; NaN if it is missing or undefined."""
        value = (self.evaluation or {}).get(key)
        if value is None:
            value = self.gait.get(key)
        return float(value) if isinstance(value, (int, float)) else math.nan


def find_runs(root: Path) -> list[Run]:
    """Find all runs below ``root``, or ``root`` itself, that have a configuration.

    Raises:
        RunError: If no run is found, or one cannot be read.
    """
    if not root.is_dir():
        raise RunError(f"No directory at {root}.")
    directories = [directory for directory in _directories(root) if _configured(directory)]
    if not directories:
        raise RunError(f"No runs below {root}: none of its directories has a {CONFIG}, as gctd3.train leaves behind.")
    return [read_run(directory, root) for directory in directories]


def lost_runs(root: Path) -> list[str]:
    """Return the names of runs below ``root`` whose configuration is empty or missing."""
    return [_name(directory, root) for directory in _directories(root) if not _configured(directory)]


def _directories(root: Path) -> list[Path]:
    """Find the directories of runs by the files that even a run killed at its beginning leaves."""
    return sorted({path.parent for name in (CONFIG.parent.name, PROGRESS) for path in root.rglob(name)})


def _configured(directory: Path) -> bool:
    file = directory / CONFIG
    # A file that a power cut emptied may hold zeros.
    return file.is_file() and bool(file.read_bytes().strip(b"\0 \r\n"))


def _name(directory: Path, root: Path) -> str:
    return str(directory.relative_to(root)) if directory != root else directory.name


def read_run(directory: Path, root: Path) -> Run:
    """Read a run with its configuration, progress and evaluations.

    Raises:
        RunError: If one of its files is damaged.
    """
    try:
        config = flat(load_config(directory))
        items = command_line(directory) if (directory / OVERRIDES).is_file() else []
        own = directory / OWN_ROBOT
        robot = str(read_manifest(own)["hash"]) if (own / MANIFEST).is_file() else None
    except (RunError, KeyError) as error:
        raise RunError(f"{error}\nMove {directory} elsewhere to report on the others.") from error
    overrides = dict(item.split("=", 1) for item in items if "=" in item)
    rows = _progress(directory / PROGRESS)
    run = Run(directory, _name(directory, root), config, overrides.get("algo", "gctd3"), rows)
    return with_results(replace(run, overrides=overrides, robot_hash=robot, trouble=_trouble(run)))


def _trouble(run: Run) -> str | None:
    """Describe the crash of a training or how far it got before it was stopped; ``None`` if it came to its end."""
    if (run.directory / POST_MORTEM).is_dir():
        try:
            return f"crashed: {read_manifest(run.directory / POST_MORTEM).get('error')}"
        except (RunError, KeyError):
            return f"crashed; {POST_MORTEM} cannot be read"
    config, rows = run.config, run.rows
    if "total_frames" not in config:
        return None
    if not rows:
        return "stopped before its first evaluation"
    last, batch = rows[-1], config.get("env.num_envs", 1) * config.get("steps", 1)
    episodes = config.get("total_episodes")
    spent = last["frames"] + batch > config["total_frames"]
    if spent or (episodes is not None and last.get("train_episodes", 0) >= episodes) or _reached(run):
        return None
    return f"stopped at {last['frames']:,.0f} of {config['total_frames']:,} frames"


def _reached(run: Run) -> bool:
    """Return whether the run's last evaluations meet the conditions of ``stop_when``, confirmed where that is asked."""
    wanted = run.config.get("stop_when.evaluations")
    late = run.rows[-wanted:] if wanted else []
    # Where nothing was to be confirmed the cell is empty, and runs of before have no such column.
    met = [run.rule.all_reached(row) and row.get("confirmed", 1.0) == 1.0 for row in late]
    return bool(late) and len(late) == wanted and all(met)


def with_results(run: Run) -> Run:
    """Return the run with its evaluation, trace and robustness, if it has them.

    Raises:
        RunError: If one of these is damaged.
    """
    file, evaluation, trace = run.directory / EVALUATION, None, None
    if file.is_file():
        try:
            evaluation = json.loads(file.read_text(encoding="utf-8"))
            if not {"return_mean", "velocity_mean", "success_rate"} <= set(evaluation):
                raise ValueError("it lacks return_mean, velocity_mean or success_rate")
        except (ValueError, TypeError) as error:
            raise RunError(f"{file} cannot be read: {error}; delete it to have the run evaluated again.") from error
    if (run.directory / TRACE).is_file():
        rows = _rows(run.directory / TRACE, "delete it, or evaluate the run again for a new one")
        trace = {key: np.array([row[key] for row in rows]) for key in rows[0]} if rows else None
    return replace(run, evaluation=evaluation, trace=trace, robustness=_robustness(run.directory / ROBUSTNESS))


def _robustness(file: Path) -> Mapping[str, Any] | None:
    if not file.is_file():
        return None
    try:
        results: Mapping[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        if not {"conditions", "pushes", "perturbations"} <= set(results):
            raise ValueError("it lacks conditions, pushes or perturbations")
    except (ValueError, TypeError) as error:
        raise RunError(f"{file} cannot be read: {error}; delete it, or examine the run again.") from error
    return results


def evaluated(runs: Sequence[Run], settings: EpisodeSettings) -> list[Run]:
    """Evaluate the runs that have no evaluation, and return all; a run that cannot be evaluated holds the reason."""
    missing = [run for run in runs if run.evaluation is None]
    done = {}
    for run in tracked(missing, "evaluating runs", len(missing)):
        done[run.name] = _evaluate(run, settings)
    return [done.get(run.name, run) for run in runs]


def _evaluate(run: Run, settings: EpisodeSettings) -> Run:
    reason = unwritable(run.directory)
    if reason is not None:
        return replace(run, failure=f"its evaluation cannot be written: {reason}")
    try:
        reward = load_settings(run.directory).evaluation.reward
        shared = {item.name: getattr(settings, item.name) for item in fields(EpisodeSettings)}
        evaluate_run(EvaluateSettings(str(run.directory), reward, **shared))
    except GCTD3Error as error:
        return replace(run, failure=str(error).replace(f"{run.directory}/", ""))
    return with_results(run)


def _progress(file: Path) -> list[dict[str, float]]:
    if not file.is_file():
        return []
    hint = f"correct it, or move {file.parent} elsewhere to report on the others"
    known = [{key: value for key, value in row.items() if math.isfinite(value)} for row in _rows(file, hint)]
    if any("frames" not in row for row in known):
        raise RunError(f"{file} cannot be read: not every line says how many frames; {hint}.")
    return known


def _rows(file: Path, hint: str) -> list[dict[str, float]]:
    """Read the rows of a CSV file as numbers by column, NaN for empty cells.

    Args:
        file: The file.
        hint: Advice to the user if it cannot be read.

    Raises:
        RunError: If it cannot.
    """
    line, rows = 1, []
    try:
        check_regular(file)
        lines = csv.reader(file.read_text(encoding="utf-8").splitlines())
        head = next(lines, [])
        for cells in filter(None, lines):
            line = lines.line_num
            if len(cells) != len(head):
                raise ValueError(f"{len(cells)} cells under {len(head)} columns")
            rows.append({key: float(text or "nan") for key, text in zip(head, cells, strict=True)})
    except (ValueError, OSError, csv.Error) as error:
        raise RunError(f"{file} cannot be read: line {line}, {error}; {hint}.") from error
    return rows
