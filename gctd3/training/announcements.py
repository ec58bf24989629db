"""What a training says before its first frame and after its last one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from hydra import compose
from omegaconf import DictConfig, OmegaConf

from gctd3.config.build import again
from gctd3.config.help import written
from gctd3.files import quoted
from gctd3.training.saved_configuration import CONFIG, flat

MINUTE = 60.0
SURE = 1.0  # success rate from which on a policy counts as one that walks
_OWN = ("resume", "robot.source")  # keys that a run sets itself, or that say only where it is
_MORE = 24  # lines; what differs in more keys than this was chosen as a whole


def opening(config: DictConfig, task: str, run: Path) -> str:
    """Describe a training that begins: its robot and length, what differs from the defaults, and where it writes."""
    lines = [
        f"{config.robot.name} on {task}: up to {config.total_frames:,} frames of {config.env.num_envs} robots, "
        f"seed {config.seed}"
    ]
    different = list(differences(config))
    if different:
        lines += ["Differs from the defaults:", *(f"  {line}" for line in different[:_MORE])]
    if len(different) > _MORE:
        lines.append(f"  and {len(different) - _MORE} more")
    lines += [f"All settings: {quoted(run / CONFIG)}", f"Run directory: {quoted(run)}"]
    return "\n".join(lines)


def differences(config: DictConfig) -> Iterator[str]:
    """List the settings of a training that differ from those of a command line without arguments, in their order."""
    defaults, own = flat(compose("config")), flat(config)
    for key, value in own.items():
        if key in _OWN or (key in defaults and defaults[key] == value):
            continue
        before = f"  (default {_text(defaults[key])})" if key in defaults else ""
        yield f"{key}={_text(value)}{before}"


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
    if success < SURE:
        lines.append("It does not walk yet." if success == 0 else "It does not walk in every episode yet.")
    lines.append(f"Evaluate it over 50 episodes:  {again(config, 'evaluate', f'run={run}', 'episodes=50')}")
    if walks:
        seen = "Watch it walk" if success == SURE else "See what it does"
        lines.append(f"{seen}:  {again(config, 'view', f'run={run}')}")
    if success < SURE and finished:
        longer = f"total_frames={2 * config.total_frames}"
        lines.append(f"Train it for longer:  {again(config, 'train', f'resume={run}', longer)}")
        lines.append(f"or begin anew with another seed, since seeds differ:  seed={config.seed + 1}")
    return "\n".join(lines)


def best_text(best: Mapping[str, float] | None, walks: bool) -> str:
    """Describe the best evaluation by its task's figures: a library's has no success rate, its robot may be fixed."""
    if best is None:
        return "It has not been evaluated yet, so it has no best policy."
    figures = [f"return {best['return_mean']:.1f} ± {best['return_std']:.1f}"]
    if walks:
        figures.append(f"success {best['success_rate']:.0%}")
    if walks or best["distance_mean"]:
        figures.append(f"{best['distance_mean']:.1f} m at {best['velocity_mean']:.2f} m/s")
    return f"Best evaluation, after {best['frames']:,.0f} frames and {duration(best['wall_s'])}: {', '.join(figures)}."


def duration(seconds: float) -> str:
    """Write a time in seconds below a minute, and in minutes above: ``12 s``, ``1.4 minutes``."""
    return f"{seconds:.0f} s" if seconds < MINUTE else f"{seconds / MINUTE:.1f} minutes"
