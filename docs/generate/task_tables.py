"""Tables of the tasks: observations, actions, reward terms, terminations, randomisations and commands."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import Any

import yaml
from hydra import compose, initialize_config_module
from markdown_table import table
from omegaconf import OmegaConf

import gctd3
from gctd3.config.build import build
from gctd3.config.fields import TARGET, find, in_markdown, meanings, settings_of
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.features import NodeFeature
from gctd3.tasks.height_scan import HeightScan
from gctd3.tasks.reward import Reward
from gctd3.tasks.simulated_task import Composition, SimulatedTask
from gctd3.tasks.terms import Command, Randomisation, RewardTerm, Termination
from gctd3.tasks.terrain import Terrain, TerrainKind

# Columns of the tables of presets: what is chosen on the command line, and what has to be said beside it.
PRESETS = {
    "reward=paper": ("reward=paper",),
    "reward=table3": ("reward=table3",),
    "reward=walk": ("reward=walk",),
    "robot=free": ("robot=free", "robot.name=robot.xml"),
}
TASKS = {"task=walk": (), "robot=free": PRESETS["robot=free"]}
OURS = "gctd3"  # the source of what is nobody else's
_ABSENT = "-"
_CITED = re.compile(r"Table 3|released script|section|arXiv|\b(?:19|20)\d\d\b")
_SOURCE = re.compile(rf"\(([^()]*(?:{_CITED.pattern})[^()]*)\)")
_UNIT = re.compile(r"\(([^()]*)\)\.$")


@lru_cache
def composed(*overrides: str) -> dict[str, Any]:
    """Compose the configuration of a training."""
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        return OmegaConf.to_container(compose("config", list(overrides)), resolve=False)


def features() -> Iterator[str]:
    """List the features of the walking task's nodes."""
    rows = []
    for name, feature in composed()["task"]["features"].items():
        cls: type[NodeFeature] = find(feature[TARGET])
        rows.append((f"`{name}`", f"`{cls.__name__}`", cls.kind, summary(cls)))
    yield from table(("`task.features`", "class", "node", "meaning"), rows)


def observation() -> Iterator[str]:
    """Show the paper's observation: each node's readings in one frame."""
    task = biped()
    rows = []
    for node, readings in zip(task.graph.nodes, task.table.readings, strict=True):
        rows.append((f"`{node}`", *("0" if one is None else f"`{one.name}`: {one.meaning}" for one in readings)))
    yield from table(("node", *(f"feature {i}" for i in range(task.features))), rows)


def actions() -> Iterator[str]:
    """Show the servos of the paper's robot: what actions mean there."""
    task = biped()
    servos = task.facts.servos
    rows = []
    for i, name in enumerate(task.robot.actuated):
        low, high = task.facts.ranges[servos.joints[i]]
        ends = (servos.centre[i] - servos.scale[i], servos.centre[i], servos.centre[i] + servos.scale[i])
        effort = f"{servos.effort[i]:.3g}" if math.isfinite(servos.effort[i]) else "none"
        numbers = (*(f"{end:.3f}" for end in ends), f"{low:.3f} to {high:.3f}")
        rows.append((i, f"`{name}`", *numbers, f"{servos.stiffness[i]:.3g}", f"{servos.damping[i]:.3g}", effort))
    heads = ("action", "joint", "-1 (rad)", "0 (rad)", "1 (rad)", "limits (rad)")
    yield from table((*heads, "stiffness (N m/rad)", "damping (N m s/rad)", "torque limit (N m)"), rows)


def reward_terms() -> Iterator[str]:
    """List the classes of reward terms."""
    rows = []
    for cls in classes(RewardTerm):
        weight = meanings(cls)["weight"] if "weight" in own_meanings(cls) else ""
        unit = _UNIT.search(weight)
        returns = inspect.getdoc(cls.__call__) or ""
        formula = in_markdown(returns.removeprefix("Return ").partition(", shape")[0])
        text = f"{cls.__doc__} {weight}"
        rows.append((f"`{cls.__name__}`", summary(cls), formula, unit[1] if unit else "1", cited(text)))
    yield from table(("class", "meaning", "reward of a step", "unit of `weight`", "source"), rows)


def reward_weights() -> Iterator[str]:
    """Compare the terms of the presets: each with its weight and its other numbers."""
    yield from _presets("reward.terms", PRESETS, lambda config: config["reward"]["terms"], weights=True)


def terminations() -> Iterator[str]:
    """List the classes of terminations."""
    rows = []
    for cls in classes(Termination):
        kind = "truncates" if cls.truncates else "terminates"
        rows.append(
            (
                f"`{cls.__name__}`",
                summary(cls),
                kind + (", a success" if cls.succeeds else ""),
                cited(cls.__doc__ or ""),
            )
        )
    yield from table(("class", "meaning", "kind", "source"), rows)


def termination_limits() -> Iterator[str]:
    """Compare the terminations of the presets."""
    yield from _presets("task.terminations", TASKS, lambda config: config["task"]["terminations"])


def starts() -> Iterator[str]:
    """List the randomisations and the commands."""
    rows = []
    for base in (Randomisation, Command):
        for cls in classes(base):
            keys = [
                f"`{s.name}={OmegaConf.create([s.default])[0]}`: {in_markdown(s.meaning)}" for s in settings_of(cls)
            ]
            rows.append((base.__name__, f"`{cls.__name__}`", summary(cls), "<br>".join(keys)))
    yield from table(("kind", "class", "meaning", "keys"), rows)


def terrain_kinds() -> Iterator[str]:
    """List the kinds of ground."""
    rows = []
    for cls in classes(TerrainKind):
        keys = [f"`{s.name}={OmegaConf.create([s.default])[0]}`: {in_markdown(s.meaning)}" for s in settings_of(cls)]
        made = "boxes" if cls.stepped else "heightfield"
        rows.append((f"`{cls.__name__}`", summary(cls), made, "<br>".join(keys) or _ABSENT))
    yield from table(("class", "meaning", "made of", "keys"), rows)


def height_scan() -> Iterator[str]:
    """List the keys of the height scan."""
    yield from _keys(HeightScan)


def terrain_keys() -> Iterator[str]:
    """List the keys of the terrain, but for its kinds."""
    yield from _keys(Terrain, "kinds")


def _keys(cls: type, *left_out: str) -> Iterator[str]:
    rows = [
        (f"`{one.name}`", f"`{OmegaConf.create([one.default])[0]}`", in_markdown(one.meaning))
        for one in settings_of(cls)
        if one.name not in left_out
    ]
    yield from table(("key", "default", "meaning"), rows)


def biped() -> SimulatedTask:
    """Build the paper's task on the paper's robot."""
    config = composed()
    robot: RobotSettings = build(OmegaConf.create(config["robot"]))
    task: Composition = build(OmegaConf.create(config["task"]))
    reward: Reward = build(OmegaConf.create(config["reward"]))
    return task.build(robot, reward)


def classes(base: type) -> list[Any]:
    """Find the terms of a kind that YAML can name by ``gctd3.NAME``, in the order of their modules."""
    found = [getattr(gctd3, name) for name in gctd3._TARGETS]
    found = [cls for cls in found if isinstance(cls, type) and issubclass(cls, base)]
    return sorted(found, key=lambda cls: (cls.__module__ != "gctd3.tasks.reward_terms", cls.__module__, line_of(cls)))


def line_of(cls: type) -> int:
    """Return the line on which a class begins."""
    return inspect.getsourcelines(cls)[1]


def summary(cls: type) -> str:
    """Return the first line of a class's docstring, without its sources."""
    return re.sub(r" (?=[.;:])", "", _SOURCE.sub("", in_markdown((cls.__doc__ or "").partition("\n")[0])))


def own_meanings(cls: type) -> str:
    """Return the part of a class's own docstring that describes its fields."""
    return (cls.__doc__ or "").partition("Attributes:")[2]


def cited(text: str) -> str:
    """Return the sources that a text cites."""
    listed = [part for found in _SOURCE.findall(text) for part in " ".join(found.split()).split("; ")]
    found = dict.fromkeys(part for part in listed if _CITED.search(part))
    found |= dict.fromkeys(re.findall(r"of (\w+ et al\. \d{4} \(arXiv:[\d.]+\))", " ".join(text.split())))
    whole = [one for one in found if not any(one != other and one in other for other in found)]
    return in_markdown("; ".join(whole)) or OURS


def _presets(key: str, presets: Mapping[str, tuple[str, ...]], terms_of: Any, weights: bool = False) -> Iterator[str]:  # noqa: ANN401
    """Compare the terms of presets, a column each."""
    columns = {preset: terms_of(composed(*overrides)) for preset, overrides in presets.items()}
    names = list(dict.fromkeys(name for terms in columns.values() for name in terms))
    rows = []
    for name in names:
        given = [terms.get(name) for terms in columns.values()]
        cls = next(find(term[TARGET]) for term in given if term is not None)
        rows.append((f"`{name}`", f"`{cls.__name__}`", *(_ABSENT if t is None else _cell(t, weights) for t in given)))
    yield from table((f"`{key}`", "class", *(f"`{preset}`" for preset in presets)), rows)


def _cell(term: dict[str, Any], weights: bool) -> str:
    """Show the numbers of a term, its weight first and bold."""
    numbers = {key: value for key, value in term.items() if key not in (TARGET, "weight")}
    shown = [f"`{key}={_yaml(value)}`" for key, value in numbers.items()]
    return "<br>".join([f"**{term['weight']:g}**", *shown] if weights else shown) or "yes"


def _yaml(value: object) -> str:
    return yaml.safe_dump(value, default_flow_style=True).removesuffix("\n").removesuffix("\n...")


TABLES = {
    "features": features,
    "observation": observation,
    "actions": actions,
    "reward-terms": reward_terms,
    "reward-weights": reward_weights,
    "terminations": terminations,
    "termination-limits": termination_limits,
    "starts": starts,
    "terrain-kinds": terrain_kinds,
    "height-scan": height_scan,
    "terrain-keys": terrain_keys,
}
