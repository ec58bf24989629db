"""Describe what is wrong with a command line in a line or two."""

from __future__ import annotations

import contextlib
import itertools
import re
import sys
from collections.abc import Sequence
from pathlib import Path

from hydra import compose, initialize_config_module
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import MarkedYAMLError, YAMLError

from gctd3.config.fields import TARGET, find, is_settings, meanings
from gctd3.config.help import CONF
from gctd3.config.options import chooses, unchosen
from gctd3.config.suggestions import nearest
from gctd3.errors import GCTD3Error, suggest

# Errors of which the user's arguments, files or memory are the reason.
USER_ERRORS = (GCTD3Error, HydraException, OmegaConfBaseException, OSError, MemoryError, YAMLError)
_JOBLIB = ("hydra/launcher", "joblib")  # an option only where the plugin is installed


def explain(error: Exception, config: str, may_change: Sequence[str] = ()) -> str:
    """Describe an error in a line or two; for an unknown key, name the nearest known one; see :func:`.command`."""
    if isinstance(error, GCTD3Error):
        return f"{error}{_replacing(str(error))}"
    if isinstance(error, MarkedYAMLError):
        mark = error.problem_mark
        return f"{mark.name}, line {mark.line + 1}: {error.problem}." if mark else str(error)
    if isinstance(error, MemoryError):
        return f"Not enough memory ({error}): lower replay.buffer_size, env.num_envs or the number of episodes."
    # Hydra's counts as an OSError.
    if isinstance(error, MissingConfigException) and error.options:
        group, _, option = str(error.missing_cfg_file).rpartition("/")
        close, accepted = suggest(option, error.options), ", ".join(error.options)
        needed = " It needs its package: pip install 'gctd3[sweep]'." if (group, option) == _JOBLIB else ""
        return f"Could not find '{group}/{option}'.{needed or close} Options of {group}: {accepted}."
    if isinstance(error, OSError):
        return f"{error.strerror}: {error.filename}" if error.filename else str(error)
    if isinstance(error, OverrideParseException):
        return f"Cannot read {error.override!r}: {str(error).splitlines()[0]}. Expected key=value."
    causes = [str(error), *([str(error.__cause__)] if error.__cause__ else [])]
    text = "\n".join(line for line in "\n".join(causes).splitlines() if line.strip())
    unknown = re.search(r"full_key: (\S+)", text) if "is not in struct" in text else None
    if unknown is None:
        return text
    key = unknown.group(1)
    parent = key.rpartition(".")[0]
    if may_change:
        return (
            f"Unknown key {key!r}: a run that is continued keeps its robot, task and reward."
            f"{nearest(key, dict.fromkeys(may_change, ''))} May change: {', '.join(may_change)}."
        )
    keys = _known_keys(config, sys.argv[1:])
    group = key.partition(".")[0]
    if not any(known.startswith(f"{group}.") for known in keys) and group in keys and chooses(f"{group}="):
        return f"Unknown key {key!r}: {unchosen(group)}"
    siblings = [k for k in keys if k.rpartition(".")[0] == parent]
    none = f" {parent} has no keys; +{key}=... adds one." if parent in keys else ""
    accepted = f" Accepted: {', '.join(siblings)}." if siblings else none
    if any(argument.startswith(f"{key}._target_=") for argument in sys.argv[1:]):
        return f"Unknown key {key!r}. To add it: +{key}._target_=...{accepted}"
    added = f" A new one is added by +{parent}=..." if re.search(r"[^\w.]", key) else ""  # a pattern
    return f"Unknown key {key!r}.{nearest(key, keys)}{accepted}{added}"


def _replacing(message: str) -> str:
    """Return how to replace settings by those of another class, if that is what ``message`` comes from."""
    for argument in sys.argv[1:]:
        place = argument.partition(f".{TARGET}=")[0]
        if f".{TARGET}=" in argument and not place.startswith("+") and f"Unknown key '{place}." in message:
            _, _, target = argument.partition("=")
            above = place.rpartition(".")[0]
            return (
                f" It was a key of the class before {target}: to replace {place}, leave it out and add yours by a new "
                f"name, {place}=null +{above}.NAME.{TARGET}={target}"
            )
    return ""


def _elsewhere(arguments: list[str]) -> list[str]:
    """Return the override with Hydra's further search paths, if a command line gives them."""
    overrides = [argument for argument in arguments if argument.startswith("hydra.searchpath=")]
    for argument, following in itertools.zip_longest(arguments, arguments[1:], fillvalue=""):
        option, _, folder = argument.partition("=")
        if option in ("--config-dir", "-cd"):
            path = str(Path(folder or following).absolute()).replace("'", "\\'")
            overrides.append(f"hydra.searchpath=['file://{path}']")
    return overrides[-1:]


def _known_keys(config: str, arguments: list[str]) -> dict[str, str]:
    """Return the meaning of every key, given those of the arguments that choose an option and are valid."""
    GlobalHydra.instance().clear()
    sound = _elsewhere(arguments)
    with initialize_config_module(CONF, version_base="1.3"):
        composed = compose(config, sound)
        for argument in filter(chooses, arguments):  # to compose takes long
            with contextlib.suppress(*USER_ERRORS):
                composed = compose(config, [*sound, argument])
                sound.append(argument)

    def walk(node: DictConfig, prefix: str) -> dict[str, str]:
        known, described = {}, _meanings(node)
        for key in map(str, node):
            value = OmegaConf.select(node, key, throw_on_missing=False)
            if key != TARGET:
                known[f"{prefix}{key}"] = described.get(key, "")
            if isinstance(value, DictConfig):
                known |= walk(value, f"{prefix}{key}.")
        return known

    return walk(composed, "")


def _meanings(node: DictConfig) -> dict[str, str]:
    """Return the meanings of the keys of settings; of a mapping that is none, or of a class not found, nothing."""
    with contextlib.suppress(ImportError):
        cls = find(str(node.get(TARGET, "")))
        return meanings(cls) if is_settings(cls) else {}
    return {}
