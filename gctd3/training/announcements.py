"""What a training says before its first frame and after its last one."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from hydra import compose
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig, OmegaConf

from gctd3.config.build import again
from gctd3.config.fields import TARGET
from gctd3.config.help import conf, written
from gctd3.config.options import chooses, ships
from gctd3.config.presets import read
from gctd3.files import quoted
from gctd3.training.saved_configuration import CONFIG, flat

MINUTE = 60.0
ERRORS = {"forward": "m/s", "side": "m/s", "turn": "rad/s"}  # units of the errors of a commanded velocity
FOLLOWED = 0.9  # share of commands from which on a policy counts as one that follows them
SURE = 1.0  # success rate from which on a policy counts as one that walks
_OWN = ("resume", "robot.source")  # keys that a run sets itself, or that say only where it is
_FEW = 3  # keys that an option was chosen for in vain
_MORE = 24  # lines; what differs in more keys than this was chosen as a whole


def opening(config: DictConfig, task: str, run: Path, arguments: Sequence[str] = ()) -> str:
    """Describe a training that begins: its robot and length, what differs from the defaults, and where it writes.

    Args:
        config: Its configuration.
        task: Name of its task.
        run: Directory of the run.
        arguments: Its command line, of which is said what does not hold.
    """
    lines = [
        f"{config.robot.name} on {task}: up to {config.total_frames:,} frames of {config.env.num_envs} robots, "
        f"seed {config.seed}"
    ]
    different = list(differences(config))
    if different:
        lines += ["Differs from the defaults:", *(f"  {line}" for line in different[:_MORE])]
    if len(different) > _MORE:
        lines.append(f"  and {len(different) - _MORE} more")
    lines += overruled(config, arguments)
    lines += [f"All settings: {quoted(run / CONFIG)}", f"Run directory: {quoted(run)}"]
    return "\n".join(lines)


def differences(config: DictConfig) -> Iterator[str]:
    """List the settings of a training that differ from those of a command line without arguments, in their order."""
    defaults, own = _defaults(str(GlobalHydra.instance().config_loader().get_search_path())), flat(config)
    for key, value in own.items():
        if key in _OWN or (key in defaults and defaults[key] == value):
            continue
        before = f"  (default {_text(defaults[key])})" if key in defaults else ""
        yield f"{key}={_text(value)}{before}"


def overruled(config: DictConfig, arguments: Sequence[str]) -> Iterator[str]:
    """List the options that a command line chooses and of which keys have other values in the configuration.

    What robot, task, ground, recipe and experiment bring comes after them, and only keys of the command line are last.
    """
    # The last choice counts: the line of a run that goes on holds earlier ones, too.
    chosen = {_place(argument): argument for argument in arguments if chooses(argument) and ships(argument)}
    asked = [_place(argument) for argument in arguments]
    for place, argument in chosen.items():
        file = conf() / str(chooses(argument)) / f"{argument.partition('=')[2]}.yaml"
        if read(file).everywhere:
            # Robots, tasks and recipes say what others may change.
            continue
        others = dict(_others(_plain(OmegaConf.load(file)), _plain(OmegaConf.select(config, place)), place))
        named = [
            f"{key}={_text(value)}"
            for key, value in others.items()
            if not any(f"{key}.".startswith(f"{one}.") for one in asked if one != place)
        ]
        if named:
            more = f" and {len(named) - _FEW} more" if len(named) > _FEW else ""
            yield f"{argument} holds but for what robot, task or recipe bring: {', '.join(named[:_FEW])}{more}"


def _place(argument: str) -> str:
    """Return where in the configuration an argument of a command line changes something."""
    name = argument.lstrip("+~").partition("=")[0]
    return name.rpartition("@")[2]


def _plain(config: object) -> Mapping[Any, Any]:
    """Return a configuration as a mapping, not resolved: what refers to another key holds while it refers to it."""
    plain = OmegaConf.to_container(config) if OmegaConf.is_config(config) else None
    return plain if isinstance(plain, dict) else {}


def _others(said: Mapping[Any, Any], now: Mapping[Any, Any], place: str, top: bool = True) -> Iterator[tuple[str, Any]]:
    """Yield the keys of a mapping, and their present values, that have another value now than it says."""
    for key, value in said.items():
        if key not in now or (key == TARGET and top):
            continue
        if isinstance(value, Mapping) and isinstance(now[key], Mapping):
            yield from _others(value, now[key], f"{place}.{key}", top=False)
        elif now[key] != value:
            yield f"{place}.{key}", now[key]


@functools.cache
def _defaults(places: str) -> Mapping[str, Any]:
    """Compose a command line without arguments, once for all runs of a sweep that look for YAMLs in these places."""
    return flat(compose("config"))


def _text(value: Any) -> str:  # noqa: ANN401 - a value of a configuration
    return written(OmegaConf.to_container(value) if OmegaConf.is_config(value) else value)


def closing(best: Mapping[str, float] | None, run: Path, config: DictConfig, walks: bool, finished: bool) -> str:
    """Describe a training that ended: its best evaluation, whether that walks, and what to run next.

    Args:
        best: The best evaluation, ``None`` without one.
        run: Directory of the run.
        config: Its configuration.
        walks: Whether it is the walking task, whose policies can be drawn.
        finished: Whether it has come to its end; one that was stopped before is to be continued as it is.
    """
    lines = ["", best_text(best, walks)]
    if best is None:
        return "\n".join(lines)
    success = best["success_rate"] if walks else SURE
    follows = _follows(best)
    if follows is not None:
        lines += [] if follows else ["It does not follow all commands yet."]
    elif success < SURE:
        does = "jump and stand" if "apex_error" in best else "walk"
        lines.append(f"It does not {does} yet." if success == 0 else f"It does not {does} in every episode yet.")
    able = success >= SURE if follows is None else follows
    lines.append(f"Evaluate it over 50 episodes:  {again(config, 'evaluate', f'run={run}', 'episodes=50')}")
    if walks:
        watch = "Watch it jump" if "apex_error" in best else "Watch it walk"
        seen = (watch if follows is None else "Steer it") if able else "See what it does"
        lines.append(f"{seen}:  {again(config, 'view', f'run={run}')}")
    if not able and finished:
        longer = f"total_frames={2 * config.total_frames}"
        lines.append(f"Train it for longer:  {again(config, 'train', f'resume={run}', longer)}")
        lines.append(f"or begin anew with another seed, since seeds differ:  seed={config.seed + 1}")
    return "\n".join(lines)


def best_text(best: Mapping[str, float] | None, walks: bool) -> str:
    """Describe the best evaluation by its task's figures: a library's has no success rate, its robot may be fixed."""
    if best is None:
        return "It has not been evaluated yet, so it has no best policy."
    said = [f"return {best['return_mean']:.1f} ± {best['return_std']:.1f}"]
    if walks or best["distance_mean"]:
        said.append(figures(best, walks))
    return f"Best evaluation, after {best['frames']:,.0f} frames and {duration(best['wall_s'])}: {', '.join(said)}."


def figures(metrics: Mapping[str, float], walks: bool = True) -> str:
    """Describe how a policy did: how far it got, or how well it followed commands.

    Args:
        metrics: Metrics of an evaluation.
        walks: Whether its success is that of a walk.
    """
    if "error_forward" in metrics:
        errors = [f"{metrics[f'error_{axis}']:.2f} {unit}" for axis, unit in ERRORS.items()]
        rates = f"{metrics['followed_rate']:.0%} of the commands followed, falls {metrics['fall_rate']:.0%}"
        return f"{rates}, errors {errors[0]} forward, {errors[1]} to the side, {errors[2]}"
    success = [f"success {metrics['success_rate']:.0%}"] if walks else []
    if "apex_error" in metrics:
        falls = f"falls {metrics['fall_rate']:.0%}"
        return ", ".join([*success, falls, f"apex {metrics['apex_mean']:.3f} m, off by {metrics['apex_error']:.3f} m"])
    return ", ".join([*success, f"{metrics['distance_mean']:.1f} m at {metrics['velocity_mean']:.2f} m/s"])


def _follows(best: Mapping[str, float]) -> bool | None:
    """Whether a policy follows nearly all commands without a fall; ``None`` for a task without commands."""
    if "followed_rate" not in best:
        return None
    return best["fall_rate"] == 0 and best["followed_rate"] >= FOLLOWED


def duration(seconds: float) -> str:
    """Write a time in seconds below a minute, and in minutes above: ``12 s``, ``1.4 minutes``."""
    return f"{seconds:.0f} s" if seconds < MINUTE else f"{seconds / MINUTE:.1f} minutes"
