"""Checks that runs may be compared: one task, the same evaluation, each seed once."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence

from gctd3.comparison.runs import Run
from gctd3.config.build import again
from gctd3.errors import RunError
from gctd3.evaluation.settings import EpisodeSettings
from gctd3.runs.evaluate import EVALUATION, ROBUSTNESS
from gctd3.training.checkpoint import FOLDER

# Keys that must be equal for numbers to be comparable, by the name of the subject.
TOGETHER = {
    "robot": tuple(f"robot.{key}" for key in ("name", "source", "root", "feet", "forward", "pose", "hold", "servos")),
    "task": ("task._target_", "task.library", "task.name", "task.control_dt", "task.randomisations", "task.commands"),
    "evaluation reward": ("evaluation.reward",),
    "terminations": ("task.terminations",),
    "terrain": ("task.terrain",),
}
# Number of episodes, and the seed of their starts; None where an evaluation does not say.
Episodes = tuple[int | None, int | None]


def check_together(runs: Sequence[Run]) -> None:
    """Refuse runs whose numbers are not comparable.

    Raises:
        RunError: If they differ in robot, task, evaluation reward, terminations or terrain; the message lists how.
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
    by_hash: dict[str, list[str]] = {}
    for run in runs:
        if run.robot_hash is not None:
            by_hash.setdefault(run.robot_hash, []).append(run.name)
    if len(by_hash) > 1 and not problems:
        # Of one name, and yet of other masses or gains.
        each = [f"{key[:12]} in {', '.join(names[:3])}{', ...' * (len(names) > 3)}" for key, names in by_hash.items()]
        problems.append(f"  robot, hash of its physics: {'; '.join(each)}")
    rewards = {json.dumps(r.evaluation["reward"], sort_keys=True) for r in runs if r.evaluation and _reward(r)}
    if len(rewards) > 1:
        problems.append(f"  the reward of {EVALUATION}; evaluate them again under one")
    tried = {json.dumps(run.robustness["perturbations"], sort_keys=True) for run in runs if run.robustness}
    if len(tried) > 1:
        problems.append(f"  the perturbations of {ROBUSTNESS}; examine them again with the same perturbations")
    if problems:
        raise RunError("These runs do not belong in one report; they differ in\n" + "\n".join(problems))


def _reward(run: Run) -> bool:
    return isinstance((run.evaluation or {}).get("reward"), Mapping)


def _spread(sets: Iterable[list[Run]], key: str) -> str:
    names_by_value: dict[str, list[str]] = {}
    for runs in sets:
        names_by_value.setdefault(str(runs[0].config.get(key)), []).extend(run.name for run in runs)
    return "; ".join(
        f"{value} in {', '.join(names[:3])}{', ...' * (len(names) > 3)}" for value, names in names_by_value.items()
    )


def check_episodes(runs: Sequence[Run], settings: EpisodeSettings) -> None:
    """Refuse runs that were, or would be, evaluated over other episodes than most of them.

    Args:
        runs: The runs.
        settings: Settings for the runs that have no evaluation yet.

    Raises:
        RunError: If some were; the message names them, and how to evaluate them alike.
    """
    by_episodes: dict[Episodes, list[Run]] = {}
    for run in runs:
        if run.evaluation is not None:
            by_episodes.setdefault(_episodes_of(run.evaluation), []).append(run)
    new = [run for run in runs if run.evaluation is None and any((run.directory / FOLDER).glob("best-*"))]
    if len(by_episodes) + bool(new) < 2:
        return
    asked = settings.episodes, settings.seed
    most = max(by_episodes, key=lambda how: (None not in how, len(by_episodes[how]), how[0] or 0))
    wanted = asked if None in most else most
    others = [run for how, members in by_episodes.items() if how != wanted for run in members]
    unlike = bool(new) and asked != wanted
    if not others and not unlike:
        return
    lines = [
        f"  {_episodes_text(*how)}: {', '.join(run.name for run in members)}" for how, members in by_episodes.items()
    ]
    if new:
        names = ", ".join(run.name for run in new)
        lines.append(f"  not yet evaluated, now to be over {_episodes_text(*asked)}: {names}")
    chosen = f"episodes={wanted[0]}", f"seed={wanted[1]}"
    remedies = [f"  {again(run.config, 'evaluate', f'run={run.directory}', *chosen)}" for run in others]
    if unlike:
        remedies.append(f"  the report's own command with {' '.join(chosen)}")
    raise RunError(
        "These runs were not evaluated over the same episodes, so their numbers cannot be compared:\n"
        + "\n".join([*lines, "To evaluate them alike:", *remedies])
    )


def _episodes_of(evaluation: Mapping[str, object]) -> Episodes:
    seeds = evaluation.get("seeds")
    values = evaluation.get("episodes"), seeds.get("evaluation") if isinstance(seeds, Mapping) else None
    episodes, seed = (value if isinstance(value, int) else None for value in values)
    return episodes, seed


def _episodes_text(episodes: int | None, seed: int | None) -> str:
    number = "an unknown number of episodes" if episodes is None else f"{episodes} episode{'s' * (episodes != 1)}"
    return f"{number} from starts of {'an unknown seed' if seed is None else f'seed {seed}'}"


def check_seeds(groups: Mapping[str, Sequence[Run]]) -> None:
    """Refuse groups that contain a seed twice, which would count as two seeds.

    Raises:
        RunError: If a group contains a seed twice; the message names the runs.
    """
    problems = []
    for group, runs in groups.items():
        by_seed: dict[tuple[object, object], list[Run]] = {}
        for run in runs:
            # Runs with other random graphs count as other seeds; this seed has no effect on graphs that are not random.
            graph = run.config.get("robot.graph_seed") if run.config.get("robot.graph") == "random" else None
            by_seed.setdefault((run.seed, graph), []).append(run)
        for (seed, _), same in by_seed.items():
            if len(same) > 1:
                problems.append(f"  {group}, seed {seed}: {' and '.join(str(run.directory) for run in same)}")
    if problems:
        raise RunError(
            "A seed counts once, but these were found more than once:\n"
            + "\n".join(problems)
            + "\nMove all but one of each elsewhere."
        )
