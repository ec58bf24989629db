"""No YAML repeats what a dataclass says: a key can be left out of a YAML if nothing changes without it."""

import copy
from functools import cache
from importlib.resources import files
from pathlib import Path

import pytest
import yaml
from omegaconf import OmegaConf

from gctd3.config.completion import complete
from gctd3.config.fields import settings_of
from gctd3.training.settings import TrainSettings

CONF = Path(str(files("gctd3.conf")))
EVERYWHERE = "# @package _global_"
OPTIONS = sorted((file.parent.name, file.stem) for file in CONF.glob("*/*.yaml"))
# In their order: a later group's options win over an earlier one's.
ORDER = [
    name.removeprefix("optional ").partition("@")[0]
    for item in yaml.safe_load((CONF / "config.yaml").read_text(encoding="utf-8"))["defaults"]
    if isinstance(item, dict)
    for name in item
]
KEYS = {setting.name for setting in settings_of(TrainSettings)}
# Keys that repeat a default, and why.
REASONS = {
    "reward/paper reward.terms": "Reward is the class of every reward, whose terms are all that it has, and walk and "
    "table3 begin with these; each has its source in the paper beside it",
}


@cache
def layers(group, option, place=None):
    """Return what an option begins with and what it says itself, from the bottom up, at the root's keys."""
    text = (CONF / group / f"{option}.yaml").read_text(encoding="utf-8")
    plain, below = yaml.safe_load(text), []
    for item in plain.get("defaults", []):
        ((name, other),) = item.items() if isinstance(item, dict) else [(f"{group}@{place or group}", item)]
        if other in (None, "_self_") or "hydra" in name:
            continue
        room, _, at = name.removeprefix("override ").lstrip("/").partition("@")
        below += layers(room, other.rpartition("/")[2].partition("@")[0], at.removeprefix("_global_.") or None)
    own = {key: value for key, value in plain.items() if key not in ("defaults", "hydra")}
    if not text.startswith(EVERYWHERE):
        for key in reversed((place or group).split(".")):
            own = {key: own}
    return [*below, own]


def completed(contents, key):
    """Return what Hydra would complete the key of a training to; other keys are left empty, to be quick."""
    others = dict.fromkeys(KEYS - {key})
    config = OmegaConf.create({"_target_": "gctd3.TrainSettings", **others})
    for content in contents:
        config = OmegaConf.merge(config, {key: content[key]} if key in content else {})
    complete(config)
    return OmegaConf.to_container(config, resolve=False)


def paths(node, path=()):
    for key, value in node.items():
        yield (*path, key)
        if isinstance(value, dict):
            yield from paths(value, (*path, key))


def at(node, path):
    """Return what is at a path; ``...`` if it is not there."""
    for key in path:
        node = node.get(key, ...) if isinstance(node, dict) else ...
    return node


def without(node, path):
    changed = copy.deepcopy(node)
    del at(changed, path[:-1])[path[-1]]
    return changed


def said(node, path):
    """Return the paths of the values at or below a path, and of classes where there is nothing else."""
    values = [inner for inner in paths(node) if inner[: len(path)] == path and not isinstance(at(node, inner), dict)]
    return [inner for inner in values if inner[-1] != "_target_"] or values


def takes_back(group, path, value):
    """Tell whether an option of an earlier group gives the key another value, which this one takes back."""
    earlier = ORDER[: ORDER.index(group)] if group in ORDER else []
    others = [at(content, path) for room, option in OPTIONS if room in earlier for content in layers(room, option)]
    return any(other not in (..., value) for other in others)


def repeated(group, option, change=lambda own: own):
    """Yield the keys of an option that can be left out."""
    *below, own = layers(group, option)
    own = change(own)
    if group in ("after_robot", "recipe") and option != "none":
        below = [*layers("task", option.partition("_")[0]), *below]
    found, wholes = [], {key: completed([*below, own], key) for key in own}
    for path in paths(own):
        # What an option or a term is, it may say; and what it begins with is no dataclass.
        named = path[-1] == "_target_" or (path == (group,) and set(own[group]) == {"_target_"})
        inside = any(path[: len(outer)] == outer for outer in found)
        if named or inside or any(at(one, path) is not ... for one in below):
            continue
        if completed([*below, without(own, path)], path[0]) == wholes[path[0]]:
            found.append(path)
            if not all(takes_back(group, inner, at(own, inner)) for inner in said(own, path)):
                yield ".".join(path)


@pytest.mark.parametrize("group, option", OPTIONS)
def test_no_yaml_repeats_a_default(group, option):
    found = [key for key in repeated(group, option) if f"{group}/{option} {key}" not in REASONS]
    assert found == []


def test_what_is_excused_is_repeated():
    for excused in REASONS:
        name, key = excused.split()
        assert key in list(repeated(*name.split("/")))


@pytest.mark.parametrize(
    "group, option, keys, value",
    [
        # A number, a term, a nested number, and a number that an option of the same group says already.
        ("task", "jump", "task.history", 3),
        ("task", "velocity", "task.features.contact", {"_target_": "gctd3.FootContact"}),
        ("task", "jump", "task.terminations.fall.drop", 0.6),
        ("reward", "jump", "reward.terms.effort.weight", -0.05),
        ("exploration", "uniform", "exploration.mutation_share", 0.0),
        ("after_robot", "jump", "reward.terms.action_rate", {"_target_": "gctd3.ActionRate", "weight": -0.02}),
    ],
)
def test_a_planted_repetition_is_found(group, option, keys, value):
    def planted(own):
        changed = copy.deepcopy(own)
        node = changed
        *outer, last = keys.split(".")
        for key in outer:
            node = node.setdefault(key, {})
        node[last] = value
        return changed

    assert any(f"{keys}.".startswith(f"{found}.") for found in repeated(group, option, planted))


def test_what_another_option_changes_may_be_taken_back():
    """The weight of Tilt in after_robot/jump is its default, and robot/free has another one."""
    path = ("reward", "terms", "tilt", "weight")
    assert at(layers("after_robot", "jump")[-1], path) == -0.5 and at(layers("robot", "free")[-1], path) == -1.0
    assert takes_back("after_robot", path, -0.5) and not takes_back("after_robot", path, -1.0)
