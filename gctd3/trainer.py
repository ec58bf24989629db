"""Training: collect, remember, update, evaluate, keep the best."""

from __future__ import annotations

import csv
import logging
import math
import time
from collections.abc import Mapping
from pathlib import Path

import torch
from torchrl import torchrl_logger
from torchrl.collectors import Collector
from torchrl.record.loggers import Logger, get_logger
from tqdm import tqdm

from gctd3.checkpoint import Checkpoints
from gctd3.device import pick_device
from gctd3.envs.factory import build_env
from gctd3.errors import ConfigError, RunError
from gctd3.evaluate import evaluate
from gctd3.exploration import Explorer
from gctd3.replay import Mirror, Replay
from gctd3.train_settings import COLUMNS, TrainSettings

PROGRESS = "progress.csv"


class Trainer:
    """One training, from its settings to a directory full of results.

    Args:
        settings: What to do.
        directory: Where to write.

    Raises:
        RunError: If the directory holds a run already.
    """

    def __init__(self, settings: TrainSettings, directory: Path) -> None:
        if (directory / PROGRESS).exists():
            raise RunError(f"{directory} holds a run already: choose another hydra.run.dir.")
        self.settings, self.directory = settings, directory
        # Its notices of every storage and transform would break into the progress bar.
        torchrl_logger.setLevel(logging.WARNING)
        if settings.threads is not None:
            torch.set_num_threads(settings.threads)
        # Before the networks, so that their initial weights are the seed's.
        torch.manual_seed(settings.seed)
        self.robot = settings.load_robot()
        self.device = pick_device(settings.device)
        self.algorithm = settings.algo.build(settings.architecture(self.device))
        env = settings.env
        self.explorer = Explorer(self.algorithm.actor, self.robot, env.num_envs, settings.exploration, env.control_dt)
        mirror = Mirror(self.robot, env.history) if settings.replay.mirror else None
        self.replay = Replay(settings.replay, settings.algo.gamma, env.history, mirror, self.device)
        self.env = build_env(self.robot, env, settings.reward, settings.seed)
        judged = env.judging(settings.evaluation.episodes)
        self.evaluation_env = build_env(self.robot, judged, settings.evaluation.reward, settings.evaluation.seed)
        self.checkpoints = Checkpoints(directory, settings.keep_checkpoints)
        self.logger = make_logger(settings.logger, directory)
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
        # The collector tries the policy once on made-up data; that was no frame.
        self.explorer.frames.zero_()
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
                learning = not self.explorer.warming_up and self.replay.ready
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
        file = self.directory / PROGRESS
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
