"""How well a policy follows each of many commanded velocities, one held through each episode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from gctd3.envs.factory import build_env
from gctd3.envs.settings import EnvSettings
from gctd3.evaluation.episode import Episode
from gctd3.evaluation.perturbations import PolicyFunction
from gctd3.evaluation.rollout import evaluate
from gctd3.evaluation.settings import SETTLE, CommandGrid
from gctd3.evaluation.tracking import errors, is_near, settled
from gctd3.tasks.heading import AXES
from gctd3.tasks.simulated_task import SimulatedTask
from gctd3.tasks.velocity_command import NAME, HeldCommand

UNITS = {"forward": "m_s", "side": "m_s", "turn": "rad_s"}


def examine(
    policy: PolicyFunction, task: SimulatedTask, env: EnvSettings, seed: int, grid: CommandGrid
) -> dict[str, Any]:
    """Evaluate a policy under each command of a grid and return the results, ready for JSON.

    ``mean_abs_error`` is the mean absolute difference of the robot's velocity in each control step from the command,
    ``mean`` the mean velocity, both from a second on after the command has got to where it is held; ``None`` for a
    command under which no robot stood for longer. A command is ``followed`` if no robot fell and the mean velocity is
    within 0.15 m/s and 0.2 rad/s of it.

    Args:
        policy: The policy.
        task: Its task, as it is evaluated.
        env: Settings of the environment.
        seed: Seed of the starts.
        grid: The commands.
    """
    rows = grid.commands(task.commands[NAME].box)
    every = np.repeat(rows, grid.starts, axis=0)
    order = HeldCommand(rows=tuple(map(tuple, every)), like=task.commands[NAME])
    held = task.with_commands({NAME: order}, round(grid.seconds / task.control_dt))
    made = build_env(held, env.for_evaluation(len(every), env.threads), seed)
    episodes = evaluate(policy, made, held, seed).episodes
    each = [episodes[i : i + grid.starts] for i in range(0, len(episodes), grid.starts)]
    commands = [_of_command(row, part, task.control_dt) for row, part in zip(rows, each, strict=True)]
    known = [one["mean_abs_error"] for one in commands if one["mean_abs_error"] is not None]
    whole = {name: float(np.mean([error[name] for error in known])) for name in known[0]} if known else None
    return {
        "grid": {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(grid).items()},
        "seed": seed,
        "settle_s": SETTLE,
        "commands": commands,
        "whole": {
            "commands": len(commands),
            "followed": sum(one["followed"] for one in commands),
            "mean_abs_error": whole,
            "fall_rate": float(np.mean([episode.fell for episode in episodes])),
        },
    }


def _of_command(command: np.ndarray, episodes: Sequence[Episode], control_dt: float) -> dict[str, Any]:
    off = [error for episode in episodes if (error := errors(episode, control_dt)) is not None]
    moved = [
        episode.moved[settled(episode.command, control_dt)].mean(axis=0)
        for episode in episodes
        if episode.command is not None and episode.moved is not None and errors(episode, control_dt) is not None
    ]
    fell, mean = sum(episode.fell for episode in episodes), np.mean(moved, axis=0) if moved else None
    return {
        "command": named(command),
        "episodes": len(episodes),
        "falls": fell,
        "followed": mean is not None and not fell and is_near(mean - command),
        "mean_abs_error": named(np.mean(off, axis=0)) if off else None,
        "mean": None if mean is None else named(mean),
    }


def named(values: np.ndarray) -> dict[str, float]:
    """Return three velocities by their names with units."""
    return {f"{axis}_{UNITS[axis]}": float(value) for axis, value in zip(AXES, values, strict=True)}


def table(results: Mapping[str, Any]) -> str:
    """Format the results as text: a line for each command, then the whole grid."""
    lines = [f"{'commanded':>24}{'mean':>24}{'mean absolute error':>24}{'falls':>8}"]
    lines.append(3 * f"{'m/s':>8}{'m/s':>8}{'rad/s':>8}")
    for one in results["commands"]:
        parts = (one["command"], one["mean"], one["mean_abs_error"])
        lines.append("".join(map(_cells, parts)) + f"{one['falls']:>4} of {one['episodes']}")
    whole = results["whole"]
    lines.append(f"{'all':>24}{'':24}{_cells(whole['mean_abs_error'])}{whole['fall_rate']:>8.0%}")
    lines.append(f"{whole['followed']} of {whole['commands']} commands are followed.")
    return "\n".join(lines)


def _cells(values: Mapping[str, float] | None) -> str:
    return "".join(f"{value:>8.2f}" for value in values.values()) if values else 3 * f"{'-':>8}"
