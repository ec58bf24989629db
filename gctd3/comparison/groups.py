"""Groups of runs that are the same but for their seeds, and the names of these groups."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import Any

from gctd3.comparison.runs import Run

# Keys in which the runs of a group may differ: the seeds.
SEEDS = ("seed", "robot.graph_seed")
# Keys that do not affect what is learnt.
UNIMPORTANT = (
    *SEEDS,
    "logger",
    "threads",
    "env.threads",
    "device",
    "keep_checkpoints",
    "checkpoint_every",
    "resume",
)
MOST_KEYS = 3  # in a name


def groups_of(runs: Sequence[Run]) -> dict[str, list[Run]]:
    """Group runs whose configurations are the same but for seeds and keys that do not affect learning, by name.

    A group is named after its algorithm; where that is not enough, after the options that it was started with
    (``experiment=``, ``network=`` and so on), then after the values in which its configuration differs. Groups of the
    graph network come first, the paper's graph before others, then by name.
    """
    alike: dict[str, list[Run]] = {}
    for run in runs:
        important = {key: value for key, value in run.config.items() if key not in UNIMPORTANT}
        alike.setdefault(json.dumps(important, sort_keys=True, default=str), []).append(run)
    named = {name: members for members, name in _names(list(alike.values()))}
    order = sorted(named, key=lambda name: (*_place(named[name][0]), _natural(name)))
    return {name: sorted(named[name], key=lambda run: run.seed) for name in order}


def typical(runs: Sequence[Run]) -> Run | None:
    """Return the evaluated run with the median return, or the one just below it; ``None`` without evaluations."""
    known = sorted((run for run in runs if run.evaluation), key=lambda run: run.value("return_mean"))
    return known[(len(known) - 1) // 2] if known else None


def with_trace(runs: Sequence[Run]) -> list[Run]:
    """Return the runs that have a trace."""
    return [run for run in runs if run.trace is not None]


def differences(runs: Sequence[Run]) -> dict[str, list[Any]]:
    """Return the keys in which configurations differ, the seeds aside, with each run's value."""
    keys = sorted({key for run in runs for key in run.config} - set(SEEDS))
    values_by_key = {key: [run.config.get(key) for run in runs] for key in keys}
    return {key: values for key, values in values_by_key.items() if any(value != values[0] for value in values)}


def _place(run: Run) -> tuple[bool, bool, bool]:
    return (
        run.algorithm != "gctd3",
        run.config.get("network.graph_layers") == [],
        run.config.get("robot.graph", "tree") != "tree",
    )


def _names(sets: list[list[Run]]) -> list[tuple[list[Run], str]]:
    named = []
    for members, label in _labelled(sets, lambda run: run.algorithm):
        for finer, options in _labelled(members, _options_in(members)):
            named += list(zip(finer, _distinct_names(f"{label} {options}".strip(), finer), strict=True))
    return named


def _labelled(sets: list[list[Run]], label: Callable[[Run], str]) -> list[tuple[list[list[Run]], str]]:
    """Group sets of runs by a label of their first run."""
    by_label: dict[str, list[list[Run]]] = {}
    for members in sets:
        by_label.setdefault(label(members[0]), []).append(members)
    return [(members, name) for name, members in by_label.items()]


def _options_in(sets: list[list[Run]]) -> Callable[[Run], str]:
    """Return a function that names the options of a run: its network, and those in which ``sets`` differ."""
    firsts = [members[0] for members in sets]
    # An override whose key is not in the configuration chose an option of a group.
    chosen = {key for run in firsts for key in run.overrides if key not in run.config and key != "algo"}
    telling = sorted(key for key in chosen if len({run.overrides.get(key) for run in firsts}) > 1 or key == "network")
    return lambda run: " ".join(run.overrides[key] for key in telling if key in run.overrides)


def _distinct_names(label: str, sets: list[list[Run]]) -> list[str]:
    """Return a distinct name for each set of runs with the same label."""
    if len(sets) == 1:
        return [label]
    firsts = [members[0] for members in sets]
    keys = [key for key in differences(firsts) if key not in UNIMPORTANT][:MOST_KEYS]
    names = [
        f"{label} " + " ".join(f"{key.rpartition('.')[2]}={run.config.get(key)}" for key in keys) for run in firsts
    ]
    return names if len(set(names)) == len(names) else [f"{label} #{i + 1}" for i in range(len(names))]


def _natural(name: str) -> list[tuple[bool, float, str]]:
    """Return a sort key that puts ``history=3`` before ``history=10``."""
    words = [word.rpartition("=")[2] for word in name.split()]
    return [
        (not word.replace(".", "", 1).isdigit(), float(word) if word.replace(".", "", 1).isdigit() else 0.0, word)
        for word in words
    ]
