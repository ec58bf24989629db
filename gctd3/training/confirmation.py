"""Confirm that a policy meets the conditions that end a training, from starts that no evaluation has used."""

from __future__ import annotations

import torch
from tensordict.nn import TensorDictModuleBase

from gctd3.envs.factory import build_env
from gctd3.evaluation.rollout import evaluate
from gctd3.tasks.task import Task
from gctd3.training.announcements import figures
from gctd3.training.settings import TrainSettings


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
    episodes = settings.env.for_evaluation(settings.stop_when.confirm, settings.env.threads)
    # To build and seed an environment draws from the generator that the training goes on with.
    with torch.random.fork_rng(devices=[]):
        env = build_env(task.evaluated(settings.evaluation.reward), episodes, seed)
        try:
            result = evaluate(policy, env, task, seed)
        finally:
            env.close(raise_if_closed=False)
    return {**result.summary(), **{key: value for key, value in result.gait().items() if key != "episodes"}}


def described(metrics: dict[str, float], episodes: int, sure: bool) -> str:
    """Describe a confirmation: from how many starts, whether the conditions are met, and what was seen."""
    verdict = "meets the conditions too" if sure else "misses the conditions that it met"
    shown = [f"return {metrics['return_mean']:.0f}"]
    if "followed_rate" in metrics:
        shown += [figures(metrics)]
    else:
        shown += [f"success {metrics['success_rate']:.0%}", f"{metrics['velocity_mean']:.2f} m/s"]
    shown += [f"{metrics['stride_hz']:.2f} Hz"] if "stride_hz" in metrics else []
    return f"From {episodes} other starts this policy {verdict}: {', '.join(shown)}."
