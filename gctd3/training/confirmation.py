"""Measure what conditions on a policy name, and confirm that it meets them from starts no evaluation has used."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import torch
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from gctd3.envs.factory import build_env
from gctd3.evaluation.rollout import evaluate
from gctd3.evaluation.summary import summarize
from gctd3.tasks.simulated_task import SimulatedTask
from gctd3.tasks.task import Task
from gctd3.training.announcements import figures
from gctd3.training.settings import TrainSettings
from gctd3.training.stop_when import RECORDED


def evaluation_env(settings: TrainSettings, task: Task, episodes: int, seed: int, threads: int | None) -> EnvBase:
    """Build the robots of an evaluation, one for each episode, under the reward of the evaluations."""
    evaluated = settings.env.for_evaluation(episodes, threads)
    if settings.stop_when.of_motion:
        # The one backend that records motions.
        evaluated = replace(evaluated, backend="batched")
    return build_env(task.evaluated(settings.evaluation.reward), evaluated, seed)


def measure(
    policy: TensorDictModuleBase, env: EnvBase, task: Task, settings: TrainSettings, seed: int
) -> dict[str, float]:
    """Evaluate a policy once on every robot of ``env``.

    Args:
        policy: The policy, on the CPU.
        env: Robots of :func:`evaluation_env`.
        task: Their task.
        settings: Settings of the training; the motion is recorded if its conditions ask for it.
        seed: Seed of the starts.

    Returns:
        The metrics that conditions name; those of gaits only if an episode got far enough.
    """
    recorded = settings.stop_when.of_motion
    result = evaluate(policy, env, task, seed, record=recorded)
    motion = summarize(result.episodes, cast(SimulatedTask, task).robot, task.control_dt) if recorded else {}
    return {
        **result.summary(),
        **{key: value for key, value in result.gait().items() if key != "episodes"},
        **{key: value for key in RECORDED if (value := motion.get(key)) is not None},
    }


def confirm(policy: TensorDictModuleBase, settings: TrainSettings, task: Task) -> dict[str, float]:
    """Evaluate a policy over ``stop_when.confirm`` episodes, each from another start than those of the evaluations.

    A policy is chosen because it did well from the evaluations' starts, so these say too much about it.

    Args:
        policy: The policy, on the CPU.
        settings: Settings of the training.
        task: The task of its robots.

    Returns:
        The metrics that conditions name; those of gaits only if an episode got far enough.
    """
    seed = settings.evaluation.seed + 1
    # To build and seed an environment draws from the generator that the training goes on with.
    with torch.random.fork_rng(devices=[]):
        env = evaluation_env(settings, task, settings.stop_when.confirm, seed, settings.env.threads)
        try:
            return measure(policy, env, task, settings, seed)
        finally:
            env.close(raise_if_closed=False)


def described(metrics: dict[str, float], episodes: int, sure: bool) -> str:
    """Describe a confirmation: from how many starts, whether the conditions are met, and what was seen."""
    verdict = "meets the conditions too" if sure else "misses the conditions that it met"
    shown = [f"return {metrics['return_mean']:.0f}"]
    if "followed_rate" in metrics or "apex_error" in metrics:
        shown += [figures(metrics)]
    else:
        shown += [f"success {metrics['success_rate']:.0%}", f"{metrics['velocity_mean']:.2f} m/s"]
    shown += [f"{metrics['stride_hz']:.2f} Hz"] if "stride_hz" in metrics else []
    return f"From {episodes} other starts this policy {verdict}: {', '.join(shown)}."
