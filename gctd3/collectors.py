"""Who collects, by the settings."""

from __future__ import annotations

from gctd3.collector import InlineCollector, ProcessSettings
from gctd3.envs.factory import build_env
from gctd3.exploration import Explorer
from gctd3.ray_cluster import RaySettings
from gctd3.robot import Robot
from gctd3.train_settings import TrainSettings
from gctd3.worker import Launch
from gctd3.workers import WorkerCollector


def build_collector(settings: TrainSettings, robot: Robot, explorer: Explorer) -> InlineCollector | WorkerCollector:
    """What delivers the steps that a training learns from.

    Args:
        settings: Of the training.
        robot: The robot.
        explorer: Acts, or is what the workers' explorers are made of.
    """
    workers = settings.collector
    if not isinstance(workers, ProcessSettings):
        env = build_env(robot, settings.env, settings.reward, settings.seed)
        return InlineCollector(env, explorer, settings.batch_steps)
    launch: Launch
    # Imported late: a run that collects inline needs neither processes nor Ray.
    if isinstance(workers, RaySettings):
        from gctd3.ray_worker import RayWorker

        launch = RayWorker
    else:
        from gctd3.process_worker import ProcessWorker

        launch = ProcessWorker
    return WorkerCollector(settings, workers, robot, explorer, launch)
