"""Build the collector that the settings ask for."""

from __future__ import annotations

from gctd3.data.exploration import Explorer
from gctd3.data.inline_collector import InlineCollector
from gctd3.data.settings import InlineSettings, ProcessSettings, RaySettings
from gctd3.data.worker import Launch
from gctd3.data.worker_collector import WorkerCollector
from gctd3.envs.factory import EnvRecipe


def build_collector(
    settings: InlineSettings | ProcessSettings, recipe: EnvRecipe, steps: int, seed: int, explorer: Explorer
) -> InlineCollector | WorkerCollector:
    """Build the collector of the steps that a training learns from.

    Args:
        settings: Settings of the collector: where the robots are stepped.
        recipe: Recipe of the environment of all robots.
        steps: Control steps of every robot in a batch.
        seed: Seed of the environment; the workers' seeds are derived from it.
        explorer: Explorer that acts, or from which the workers' explorers are made.
    """
    if not isinstance(settings, ProcessSettings):
        return InlineCollector(recipe.make(seed), explorer, steps)
    launch: Launch
    # Imported late: a run that collects inline needs neither processes nor Ray.
    if isinstance(settings, RaySettings):
        from gctd3.data.ray_worker import RayWorker

        launch = RayWorker
    else:
        from gctd3.data.process_worker import ProcessWorker

        launch = ProcessWorker
    return WorkerCollector(settings, recipe, steps, seed, explorer, launch)
