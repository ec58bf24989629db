"""Runs below a directory: what they are, how they ended, and whether they may be compared."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import OmegaConf
from tqdm import tqdm

from gctd3.errors import GCTD3Error, RunError
from gctd3.evaluate import EVALUATION, ROBUSTNESS, TRACE, EvaluateSettings, evaluate_run
from gctd3.evaluation import Judging
from gctd3.files import MANIFEST, read_manifest
from gctd3.run_config import CONFIG, OVERRIDES, flat, load_config, load_settings
from gctd3.run_log import PROGRESS
from gctd3.train_settings import StopWhen
from gctd3.trainer import POST_MORTEM

# What has to be the same for numbers to mean the same, and what it is called.
TOGETHER = {
    "robot": ("robot.name", "robot.feet", "robot.forward"),
    "task": ("env._target_", "env.library", "env.task", "env.control_dt", "env.start"),
    "evaluation reward": ("evaluation.reward",),
    "endings": ("env.endings",),
}
# All that is read of a run, but for its policy.
READ = (CONFIG, OVERRIDES, *map(Path, (PROGRESS, EVALUATION, TRACE, ROBUSTNESS)), Path(POST_MORTEM) / MANIFEST)


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
        robustness: Its ``robustness.json``.
        failure: Why it has no evaluation.
        trouble: What kept its training from its end.
        overrides: The command line that it was started with, by key.
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

    @property
    def seed(self) -> int:
        """Of the training."""
        return int(self.config.get("seed", 0))

    @property
    def minutes(self) -> float:
        """From the beginning to its last evaluation, NaN if there was none."""
        return self.rows[-1].get("wall_s", math.nan) / 60.0 if self.rows else math.nan

    @property
    def minutes_to_finish(self) -> float:
        """Until the first evaluation in which every episode reached the finish; NaN if there was none."""
        return self.finished[0].get("wall_s", math.nan) / 60.0 if self.finished else math.nan

    @property
    def finished(self) -> list[Mapping[str, float]]:
        """Its evaluations in training in which every episode reached the finish."""
        return [row for row in self.rows if row.get("success_rate", 0.0) >= 1.0]

    @property
    def rule(self) -> StopWhen:
        """By which it ranked its policies."""
        at_least, at_most = (
            {
                key.rpartition(".")[2]: value
                for key, value in self.config.items()
                if key.startswith(f"stop_when.{side}.")
            }
            for side in ("at_least", "at_most")
        )
        return StopWhen(at_least, at_most)

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
    return [read_run(directory, root) for directory in directories]


def read_run(directory: Path, root: Path) -> Run:
    """A run and what has been written about it."""
    overrides = {}
    if (directory / OVERRIDES).is_file():
        items = [str(item) for item in OmegaConf.load(directory / OVERRIDES)]
        overrides = dict(item.split("=", 1) for item in items if "=" in item)
    name = str(directory.relative_to(root)) if directory != root else directory.name
    config, rows = flat(load_config(directory)), _progress(directory / PROGRESS)
    run = Run(directory, name, config, overrides.get("algo", "gctd3"), rows)
    return judged(replace(run, overrides=overrides, trouble=_trouble(run)))


def _trouble(run: Run) -> str | None:
    """What a crash left behind, or that the training is not over; ``None`` of one that came to its end."""
    if (run.directory / POST_MORTEM).is_dir():
        try:
            return f"crashed: {read_manifest(run.directory / POST_MORTEM)['error']}"
        except (RunError, KeyError):
            return f"crashed; what is in {POST_MORTEM} cannot be read"
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
    """Whether its last evaluations show what ``stop_when`` asks for."""
    wanted = run.config.get("stop_when.evaluations")
    late = run.rows[-wanted:] if wanted else []
    return bool(late) and len(late) == wanted and all(map(run.rule.all_reached, late))


def judged(run: Run) -> Run:
    """The run with its evaluation, trace and robustness, if it has them.

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
        rows = list(csv.DictReader((run.directory / TRACE).read_text(encoding="utf-8").splitlines()))
        trace = {key: np.array([float(row[key]) for row in rows]) for key in rows[0]} if rows else None
    return replace(run, evaluation=evaluation, trace=trace, robustness=_robustness(run.directory / ROBUSTNESS))


def _robustness(file: Path) -> Mapping[str, Any] | None:
    if not file.is_file():
        return None
    try:
        found: Mapping[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        if not {"conditions", "shoves", "perturbations"} <= set(found):
            raise ValueError("it lacks conditions, shoves or perturbations")
    except (ValueError, TypeError) as error:
        raise RunError(f"{file} cannot be read: {error}; delete it, or examine the run again.") from error
    return found


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
    tried = {json.dumps(run.robustness["perturbations"], sort_keys=True) for run in runs if run.robustness}
    if len(tried) > 1:
        problems.append(f"  what {ROBUSTNESS} tried; examine them again with the same perturbations")
    if problems:
        raise RunError("These runs do not belong in one report; they differ in\n" + "\n".join(problems))


def _reward(run: Run) -> bool:
    return isinstance((run.evaluation or {}).get("reward"), Mapping)


def _spread(sets: Iterable[list[Run]], key: str) -> str:
    found: dict[str, list[str]] = {}
    for runs in sets:
        found.setdefault(str(runs[0].config.get(key)), []).extend(run.name for run in runs)
    return "; ".join(f"{value} in {', '.join(names[:3])}{', ...' * (len(names) > 3)}" for value, names in found.items())


def evaluated(runs: Sequence[Run], judging: Judging) -> list[Run]:
    """The runs, those that had no evaluation now with one, or with the reason why there can be none."""
    missing = [run for run in runs if run.evaluation is None]
    done = {}
    for run in tqdm(missing, desc="evaluating", unit=" run", disable=not missing):
        done[run.name] = _evaluate(run, judging)
    return [done.get(run.name, run) for run in runs]


def _evaluate(run: Run, judging: Judging) -> Run:
    try:
        reward = load_settings(run.directory).evaluation.reward
        shared = {item.name: getattr(judging, item.name) for item in fields(Judging)}
        evaluate_run(EvaluateSettings(str(run.directory), reward, **shared))
    except GCTD3Error as error:
        return replace(run, failure=str(error).replace(f"{run.directory}/", ""))
    return judged(run)


def _progress(file: Path) -> list[dict[str, float]]:
    if not file.is_file():
        return []
    rows = csv.DictReader(file.read_text(encoding="utf-8").splitlines())
    numbers = [{key: float(text) for key, text in row.items() if key and text} for row in rows]
    return [{key: value for key, value in row.items() if math.isfinite(value)} for row in numbers]
