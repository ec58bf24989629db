"""Runs below a directory: what they are, whether they may be compared, and in which groups of seeds they fall."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import OmegaConf
from tqdm import tqdm

from gctd3.errors import GCTD3Error, RunError
from gctd3.evaluate import EVALUATION, TRACE, EvaluateSettings, evaluate_run
from gctd3.run_config import CONFIG, OVERRIDES, flat, load_config, load_settings
from gctd3.run_log import PROGRESS

# What has to be the same for numbers to mean the same, and what it is called.
TOGETHER = {
    "robot": ("robot.name", "robot.feet", "robot.forward"),
    "task": ("env._target_", "env.library", "env.task", "env.control_dt", "env.start"),
    "evaluation reward": ("evaluation.reward",),
    "endings": ("env.endings",),
}
# What makes no difference to what is learnt.
UNIMPORTANT = (
    "seed",
    "logger",
    "threads",
    "env.threads",
    "device",
    "keep_checkpoints",
    "checkpoint_every",
    "resume",
)


@dataclass(frozen=True)
class Run:
    """One training and its judgement.

    Attributes:
        directory: Where it is.
        name: Its path below the directory that is reported on.
        config: Its configuration by dotted key.
        algorithm: The option of ``algo`` that it was started with.
        rows: Its evaluations in training, as in ``progress.csv``; what is undefined is left out.
        evaluation: Its ``evaluation.json``.
        trace: Columns of its ``trace.csv``.
        failure: Why it has no evaluation.
        group: What it is compared as, all seeds together.
        overrides: The command line that it was started with, by key.
    """

    directory: Path
    name: str
    config: Mapping[str, Any]
    algorithm: str
    rows: Sequence[Mapping[str, float]] = ()
    evaluation: Mapping[str, Any] | None = None
    trace: Mapping[str, np.ndarray] | None = None
    failure: str | None = None
    group: str = ""
    overrides: Mapping[str, str] = field(default_factory=dict)

    @property
    def seed(self) -> int:
        """Of the training."""
        return int(self.config.get("seed", 0))

    @property
    def minutes(self) -> float:
        """From the beginning to its last evaluation, NaN if there was none."""
        return self.rows[-1]["wall_s"] / 60.0 if self.rows else math.nan

    @property
    def minutes_to_finish(self) -> float:
        """Until the first evaluation in which every episode reached the finish; NaN if there was none."""
        return next((row["wall_s"] / 60.0 for row in self.rows if row.get("success_rate", 0.0) >= 1.0), math.nan)

    def value(self, key: str) -> float:
        """A number of its evaluation, of the gait if it is not at the top; NaN if it is missing or undefined."""
        found = (self.evaluation or {}).get(key)
        if found is None:
            found = ((self.evaluation or {}).get("gait") or {}).get(key)
        return float(found) if isinstance(found, (int, float)) else math.nan


def find_runs(root: Path) -> list[Run]:
    """All runs below ``root``, or ``root`` itself.

    Raises:
        RunError: If there is none, or one cannot be read.
    """
    if not root.is_dir():
        raise RunError(f"No directory at {root}.")
    directories = sorted(file.parent.parent for file in root.rglob(str(CONFIG)))
    if not directories:
        raise RunError(f"No runs below {root}: none of its directories has a {CONFIG}, as gctd3.train leaves behind.")
    return grouped([read_run(directory, root) for directory in directories])


def read_run(directory: Path, root: Path) -> Run:
    """A run and what has been written about it."""
    overrides = {}
    if (directory / OVERRIDES).is_file():
        items = [str(item) for item in OmegaConf.load(directory / OVERRIDES)]
        overrides = dict(item.split("=", 1) for item in items if "=" in item)
    name = str(directory.relative_to(root)) if directory != root else directory.name
    run = Run(
        directory, name, flat(load_config(directory)), overrides.get("algo", "gctd3"), _progress(directory / PROGRESS)
    )
    return judged(replace(run, overrides=overrides))


def judged(run: Run) -> Run:
    """The run with its evaluation and trace, if it has them.

    Raises:
        RunError: If its evaluation is damaged.
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
        rows = list(csv.DictReader((run.directory / TRACE).read_text(encoding="utf-8").splitlines()))
        trace = {key: np.array([float(row[key]) for row in rows]) for key in rows[0]} if rows else None
    return replace(run, evaluation=evaluation, trace=trace)


def check_together(runs: Sequence[Run]) -> None:
    """Refuse runs whose numbers do not mean the same.

    Raises:
        RunError: If they differ in robot, task, evaluation reward or endings; it says which, and in what.
    """
    problems = []
    for what, keys in TOGETHER.items():
        by_value: dict[str, list[Run]] = {}
        for run in runs:
            chosen = {k: v for k, v in run.config.items() if any(k == key or k.startswith(f"{key}.") for key in keys)}
            by_value.setdefault(json.dumps(chosen, sort_keys=True, default=str), []).append(run)
        if len(by_value) > 1:
            variants = [json.loads(text) for text in by_value]
            differing = sorted({k for v in variants for k in v if any(v.get(k) != o.get(k) for o in variants)})
            problems += [f"  {what}, {key}: {_spread(by_value.values(), key)}" for key in differing]
    rewards = {json.dumps(r.evaluation["reward"], sort_keys=True) for r in runs if r.evaluation and _reward(r)}
    if len(rewards) > 1:
        problems.append(f"  the reward under which {EVALUATION} judges; evaluate them again under one")
    if problems:
        raise RunError("These runs do not belong in one report; they differ in\n" + "\n".join(problems))


def _reward(run: Run) -> bool:
    return isinstance((run.evaluation or {}).get("reward"), Mapping)


def _spread(sets: Iterable[list[Run]], key: str) -> str:
    found: dict[str, list[str]] = {}
    for runs in sets:
        found.setdefault(str(runs[0].config.get(key)), []).extend(run.name for run in runs)
    return "; ".join(f"{value} in {', '.join(names[:3])}{', ...' * (len(names) > 3)}" for value, names in found.items())


def evaluated(runs: Sequence[Run], episodes: int, seed: int, threads: int | None) -> list[Run]:
    """The runs, those that had no evaluation now with one, or with the reason why there can be none."""
    missing = [run for run in runs if run.evaluation is None]
    done = {}
    for run in tqdm(missing, desc="evaluating", unit=" run", disable=not missing):
        done[run.name] = _evaluate(run, episodes, seed, threads)
    return [done.get(run.name, run) for run in runs]


def _evaluate(run: Run, episodes: int, seed: int, threads: int | None) -> Run:
    try:
        reward = load_settings(run.directory).evaluation.reward
        evaluate_run(EvaluateSettings(str(run.directory), reward, episodes, seed, threads))
    except GCTD3Error as error:
        return replace(run, failure=str(error))
    return judged(run)


def grouped(runs: Sequence[Run]) -> list[Run]:
    """The runs with their groups: those whose configurations differ in nothing that matters but the seed."""
    settings: dict[str, list[Run]] = {}
    for run in runs:
        important = {key: value for key, value in run.config.items() if key not in UNIMPORTANT}
        settings.setdefault(json.dumps(important, sort_keys=True, default=str), []).append(run)
    labels: dict[str, list[list[Run]]] = {}
    for members in settings.values():
        first = members[0]
        network = first.overrides.get("network")
        labels.setdefault(f"{first.algorithm} {network}" if network else first.algorithm, []).append(members)
    named: dict[str, str] = {}
    for label, sets in labels.items():
        said = [""] * len(sets)
        if len(sets) > 1:
            keys = [key for key in differences([members[0] for members in sets]) if key not in UNIMPORTANT]
            said = [
                " " + " ".join(f"{key.rpartition('.')[2]}={members[0].config.get(key)}" for key in keys[:3])
                for members in sets
            ]
            if len(set(said)) < len(sets):
                said = [f" #{i + 1}" for i in range(len(sets))]
        for members, more in zip(sets, said, strict=True):
            named |= {run.name: label + more for run in members}
    return [replace(run, group=named[run.name]) for run in runs]


def groups_of(runs: Sequence[Run]) -> dict[str, list[Run]]:
    """Runs by group; the graph network's first, then by name."""
    order = sorted({run.group for run in runs}, key=lambda group: (not group.startswith("gctd3"), group))
    return {group: sorted((r for r in runs if r.group == group), key=lambda r: r.seed) for group in order}


def differences(runs: Sequence[Run]) -> dict[str, list[Any]]:
    """Keys in which configurations differ, the seed aside, with each run's value."""
    keys = sorted({key for run in runs for key in run.config} - {"seed"})
    found = {key: [run.config.get(key) for run in runs] for key in keys}
    return {key: values for key, values in found.items() if any(value != values[0] for value in values)}


def _progress(file: Path) -> list[dict[str, float]]:
    if not file.is_file():
        return []
    rows = csv.DictReader(file.read_text(encoding="utf-8").splitlines())
    numbers = [{key: float(text) for key, text in row.items() if key and text} for row in rows]
    return [{key: value for key, value in row.items() if math.isfinite(value)} for row in numbers]
