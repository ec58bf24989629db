"""Training: collect, remember, update, evaluate, keep the best."""

from __future__ import annotations

import csv
import logging
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import torch
from torchrl import torchrl_logger
from torchrl.collectors import Collector
from torchrl.record.loggers import Logger, get_logger
from tqdm import tqdm

from gctd3.algorithms.base import AlgorithmSettings, Architecture
from gctd3.checkpoint import Checkpoints
from gctd3.envs.factory import EnvSettings, build_env
from gctd3.envs.gait import FEATURES, Reward, WalkingTask
from gctd3.errors import ConfigError
from gctd3.evaluate import evaluate
from gctd3.exploration import ExplorationSettings, Explorer
from gctd3.graph import KinematicGraph
from gctd3.nn import Network
from gctd3.replay import Mirror, Replay, ReplaySettings
from gctd3.robot import Robot

COLUMNS = (
    "frames",
    "updates",
    "wall_s",
    "return_mean",
    "return_std",
    "velocity_mean",
    "distance_mean",
    "success_rate",
    "hip_correlation",
    "stride_hz",
    "flight_fraction",
)


@dataclass(frozen=True)
class RobotSettings:
    """Which robot, and which graph over it.

    Attributes:
        name: A shipped robot, or the path of an MJCF file.
        graph: Preset of :meth:`gctd3.KinematicGraph.from_robot`.
        graph_seed: For ``graph=random``.
    """

    name: str = "biped"
    graph: Literal["tree", "authors", "edgeless", "complete", "random"] = "tree"
    graph_seed: int = 0


@dataclass(frozen=True)
class EvaluationSettings:
    """How training judges its policy.

    Attributes:
        every: Frames between evaluations.
        episodes: Episodes of each.
        seed: Of their starts: the same in every evaluation, and not the training's.
        reward: Under which they are judged.
    """

    reward: Reward
    every: int = 20_000
    episodes: int = 10
    seed: int = 1_000

    def __post_init__(self) -> None:
        for name in ("every", "episodes"):
            if getattr(self, name) < 1:
                raise ConfigError(f"evaluation.{name} must be at least 1, got {getattr(self, name)}.")


@dataclass(frozen=True)
class StopWhen:
    """What an evaluation has to show; it ranks policies, and can end the training.

    Attributes:
        at_least: Lowest values, by the name of the metric.
        at_most: Highest values, by the name of the metric.
        evaluations: Evaluations in a row that must show all of it to end the training; ``None`` to train on.
    """

    at_least: Mapping[str, float] = field(default_factory=dict)
    at_most: Mapping[str, float] = field(default_factory=dict)
    evaluations: int | None = None

    def __post_init__(self) -> None:
        unknown = [name for name in (*self.at_least, *self.at_most) if name not in COLUMNS]
        if unknown:
            raise ConfigError(f"stop_when has no metric {', '.join(unknown)}; there are {', '.join(COLUMNS)}.")
        if self.evaluations is not None and self.evaluations < 1:
            raise ConfigError(f"stop_when.evaluations must be at least 1, or null, got {self.evaluations}.")

    def reached(self, metrics: Mapping[str, float]) -> int:
        """How many of the conditions hold; an undefined metric meets none."""
        low = sum(metrics.get(name, math.nan) >= bound for name, bound in self.at_least.items())
        high = sum(metrics.get(name, math.nan) <= bound for name, bound in self.at_most.items())
        return low + high

    def all_reached(self, metrics: Mapping[str, float]) -> bool:
        """Whether all of the conditions hold."""
        return self.reached(metrics) == len(self.at_least) + len(self.at_most)

    def score(self, metrics: Mapping[str, float]) -> float:
        """Ranks policies by the conditions that they meet, then by return."""
        return self.reached(metrics) + math.tanh(metrics["return_mean"] / 1e4)


@dataclass(frozen=True)
class TrainSettings:
    """Everything that a training is determined by.

    Attributes:
        robot: Which robot and graph.
        env: How it is simulated.
        reward: For which it trains.
        algo: The algorithm.
        network: Its networks.
        exploration: How it tries things out.
        replay: What it remembers.
        evaluation: How it is judged.
        stop_when: What it has to show.
        seed: Of networks, exploration, replay and starts.
        total_frames: Frames to collect, all robots together.
        total_episodes: Episodes after which to end, counted as they end; ``None`` for any number.
        steps: Control steps of every robot between updates.
        updates: Updates after those.
        threads: Of PyTorch; its own default if ``None``.
        logger: Where curves go, besides ``progress.csv``.
        keep_checkpoints: Newest checkpoints to keep, besides the best.
    """

    robot: RobotSettings
    env: EnvSettings
    reward: Reward
    algo: AlgorithmSettings
    network: Network
    exploration: ExplorationSettings
    replay: ReplaySettings
    evaluation: EvaluationSettings
    stop_when: StopWhen
    seed: int = 0
    total_frames: int = 400_000
    total_episodes: int | None = None
    steps: int = 1
    updates: int = 4
    threads: int | None = None
    logger: Literal["csv", "tensorboard", "wandb", "mlflow", "none"] = "tensorboard"
    keep_checkpoints: int = 1

    def __post_init__(self) -> None:
        for name in ("total_frames", "steps", "updates", "keep_checkpoints"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} must be at least 1, got {getattr(self, name)}.")
        if self.total_episodes is not None and self.total_episodes < 1:
            raise ConfigError(f"total_episodes must be at least 1, or null, got {self.total_episodes}.")
        if self.seed < 0:
            raise ConfigError(f"seed must be at least 0, got {self.seed}.")
        if self.threads is not None and self.threads < 1:
            raise ConfigError(f"threads must be at least 1, or null, got {self.threads}.")
        frames = self.env.num_envs * self.steps
        if self.total_frames < frames:
            raise ConfigError(
                f"total_frames must be at least env.num_envs * steps = {frames}, got {self.total_frames}."
            )
        if self.replay.mirror and self.env.history < 1:
            raise ConfigError("replay.mirror needs env.history of at least 1.")

    def load_robot(self) -> Robot:
        """The robot.

        Raises:
            RobotError: If it cannot be used.
        """
        return Robot.from_mjcf(self.robot.name)

    def architecture(self) -> Architecture:
        """What the networks are built from."""
        robot = self.load_robot()
        task = WalkingTask(robot, self.reward, self.env.endings, self.env.control_dt)
        return Architecture(
            graph=KinematicGraph.from_robot(robot, self.robot.graph, self.robot.graph_seed),
            network=self.network,
            in_features=FEATURES * self.env.history,
            action_dim=len(robot.actuated),
            privileged_dim=task.num_counters if self.algo.privileged_critic else 0,
        )


class Trainer:
    """One training, from its settings to a directory full of results.

    Args:
        settings: What to do.
        directory: Where to write.
    """

    def __init__(self, settings: TrainSettings, directory: Path) -> None:
        self.settings, self.directory = settings, directory
        # Its notices of every storage and transform would break into the progress bar.
        torchrl_logger.setLevel(logging.WARNING)
        if settings.threads is not None:
            torch.set_num_threads(settings.threads)
        # Before the networks, so that their initial weights are the seed's.
        torch.manual_seed(settings.seed)
        self.robot = settings.load_robot()
        self.algorithm = settings.algo.build(settings.architecture())
        env = settings.env
        self.explorer = Explorer(self.algorithm.actor, self.robot, env.num_envs, settings.exploration, env.control_dt)
        mirror = Mirror(self.robot, env.history) if settings.replay.mirror else None
        self.replay = Replay(settings.replay, settings.algo.gamma, mirror)
        self.env = build_env(self.robot, env, settings.reward, settings.seed)
        judged = EnvSettings(
            backend="batched",
            num_envs=settings.evaluation.episodes,
            history=env.history,
            control_dt=env.control_dt,
            threads=env.threads,
            start=env.start,
            endings=env.endings,
        )
        self.evaluation_env = build_env(self.robot, judged, settings.evaluation.reward, settings.evaluation.seed)
        self.checkpoints = Checkpoints(directory, settings.keep_checkpoints)
        self.logger = make_logger(settings.logger, directory)
        self.progress: list[dict[str, float]] = []
        self.best: dict[str, float] | None = None

    def run(self) -> dict[str, float]:
        """Train.

        Returns:
            The metrics of the best evaluation.
        """
        settings = self.settings
        batch_frames = settings.env.num_envs * settings.steps
        collector = Collector(
            self.env,
            self.explorer,
            frames_per_batch=batch_frames,
            total_frames=settings.total_frames // batch_frames * batch_frames,
        )
        began, frames, episodes, in_a_row = time.monotonic(), 0, 0, 0
        next_evaluation = max(settings.evaluation.every, settings.exploration.warmup_frames)
        with tqdm(
            total=settings.total_frames,
            unit=" steps",
            unit_scale=True,
            smoothing=0.05,
            mininterval=0.5,
            dynamic_ncols=True,
        ) as bar:
            for collected in collector:
                frames += collected.numel()
                episodes += int(collected["next", "done"].sum())
                self.replay.extend(collected)
                learning = not self.explorer.warming_up and len(self.replay) >= settings.replay.batch_size
                for _ in range(settings.updates if learning else 0):
                    metrics = self.algorithm.update(self.replay.sample())
                bar.update(collected.numel())
                last = frames >= collector.total_frames or episodes >= (settings.total_episodes or math.inf)
                if frames < next_evaluation and not last:
                    continue
                next_evaluation += settings.evaluation.every
                row = self._evaluate(frames, time.monotonic() - began)
                if learning:
                    row_metrics = {f"train/{name}": float(value) for name, value in metrics.items()}
                    self._log(row_metrics, frames)
                bar.set_postfix(self._postfix(row), refresh=True)
                in_a_row = in_a_row + 1 if settings.stop_when.all_reached(row) else 0
                if last or in_a_row == settings.stop_when.evaluations:
                    break
        collector.shutdown()
        if self.best is None:
            raise RuntimeError("The training ended without an evaluation.")
        return self.best

    def _evaluate(self, frames: int, wall: float) -> dict[str, float]:
        settings = self.settings
        policy = self.algorithm.policy()
        result = evaluate(policy, self.evaluation_env, self.robot, settings.evaluation.seed, settings.env.control_dt)
        metrics: dict[str, float] = {
            "frames": frames,
            "updates": self.algorithm.updates,
            "wall_s": round(wall, 2),
            **result.summary(),
            **{key: value for key, value in result.gait().items() if key != "episodes"},
        }
        self._write_row(metrics)
        self._log({f"evaluation/{name}": metrics[name] for name in COLUMNS[3:] if name in metrics}, frames)
        score = settings.stop_when.score(metrics)
        self.checkpoints.save(frames, score, metrics, policy=policy, algorithm=self.algorithm, explorer=self.explorer)
        if self.best is None or score > settings.stop_when.score(self.best):
            self.best = metrics
        return metrics

    def _write_row(self, metrics: Mapping[str, float]) -> None:
        file = self.directory / "progress.csv"
        new = not file.exists()
        with file.open("a", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, COLUMNS, extrasaction="ignore", restval="")
            if new:
                writer.writeheader()
            writer.writerow(metrics)

    def _log(self, metrics: Mapping[str, float], frames: int) -> None:
        if self.logger is not None:
            for name, value in metrics.items():
                self.logger.log_scalar(name, value, step=frames)

    def _postfix(self, row: Mapping[str, float]) -> dict[str, str]:
        best = self.best if self.best is not None else row
        return {
            "updates/s": f"{row['updates'] / max(row['wall_s'], 1e-9):.0f}",
            "return": f"{row['return_mean']:.0f}",
            "success": f"{row['success_rate']:.0%}",
            "best": f"{best['return_mean']:.0f}",
        }


def make_logger(kind: str, directory: Path) -> Logger | None:
    """A TorchRL logger that writes below ``directory``.

    Raises:
        ConfigError: If its package is not installed.
    """
    if kind == "none":
        return None
    try:
        return get_logger(kind, logger_name=str(directory), experiment_name=kind)
    except (ImportError, ModuleNotFoundError) as error:
        raise ConfigError(f"logger={kind} needs its package: pip install 'gctd3[{kind}]' ({error}).") from error
