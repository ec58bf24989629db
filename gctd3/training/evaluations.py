"""Evaluate the policies of a training, and keep the best one."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from typing import cast

from tensordict.nn import TensorDictModuleBase
from torch.nn import Module
from torchrl.envs import EnvBase
from tqdm import tqdm

from gctd3.data.gait_policy import fittest_gait
from gctd3.data.motion_search import MotionSearch
from gctd3.errors import RunError
from gctd3.files import write_text
from gctd3.tasks.simulated_task import SimulatedTask
from gctd3.tasks.task import Task
from gctd3.training.announcements import figures
from gctd3.training.checkpoint import Checkpoints, checked
from gctd3.training.confirmation import confirm, described, measure
from gctd3.training.progress import Counters
from gctd3.training.run_log import RunLog
from gctd3.training.settings import TrainSettings

WARMUP_GAIT = "warmup_gait.json"  # what the warm-up's fittest gait reaches without a policy
CANDIDATES = 4  # of the last gaits of a round that are evaluated, each in about a quarter of a round's time (Go2)


class Evaluations:
    """Evaluate policies on robots of their own, write a row for each evaluation, and keep the best policy.

    Args:
        settings: Settings of the training.
        task: Its task.
        env: Robots of :func:`.evaluation_env`.
        checkpoints: Where the best policy is kept.
        log: Log of the run.

    Attributes:
        best: Metrics of the best evaluation so far; ``None`` before the first one.
    """

    def __init__(
        self, settings: TrainSettings, task: Task, env: EnvBase, checkpoints: Checkpoints, log: RunLog
    ) -> None:
        self.settings, self.task, self.env = settings, task, env
        self.checkpoints, self.log = checkpoints, log
        self.best: dict[str, float] | None = None

    def evaluate(
        self, policy: TensorDictModuleBase, rhythm: Module | None, now: Counters, wall: Callable[[], float]
    ) -> dict[str, float]:
        """Evaluate a policy, and keep it if it is the best one so far.

        Args:
            policy: The policy, on the CPU.
            rhythm: Motions of the warm-up, of which the fittest one is evaluated before the first policy.
            now: Counters of the training, in which evaluations in a row that met all conditions are counted.
            wall: Function that returns the seconds spent.

        Returns:
            The row of the evaluation.
        """
        settings = self.settings
        if not self.knows_gait:
            self._evaluate_gait(rhythm)
        metrics: dict[str, float] = {
            "frames": now.frames,
            "updates": now.updates,
            "wall_s": round(wall(), 2),
            "diverged": now.diverged,
            "train_episodes": now.episodes,
            "restarts": now.restarts,
            **measure(policy, self.env, self.task, settings, settings.evaluation.seed),
        }
        sure = self._confirmed(policy, metrics, now)
        if sure is not None:
            metrics["confirmed"] = float(sure)
        if sure or self.best is None or settings.stop_when.score(metrics) > settings.stop_when.score(self.best):
            self.checkpoints.save_best(now.frames, policy, metrics)
            self.best = metrics
        self.log.add_row(metrics)
        if settings.video:
            # Imported late, since most trainings film nothing.
            from gctd3.viz.film import FPS, clip

            self.log.clip(clip(policy, cast(SimulatedTask, self.task), settings.evaluation.seed), FPS, now.frames)
        return metrics

    def _confirmed(self, policy: TensorDictModuleBase, metrics: Mapping[str, float], now: Counters) -> bool | None:
        """Count evaluations in a row that met all conditions; return whether a policy that would end is confirmed.

        ``None`` where nothing is to be confirmed.
        """
        stop_when = self.settings.stop_when
        now.in_a_row = now.in_a_row + 1 if stop_when.all_reached(metrics) else 0
        if not stop_when.confirm or not stop_when.ends_after(now.in_a_row):
            return None
        again = confirm(policy, self.settings, self.task)
        sure = stop_when.all_reached(again)
        if not sure:
            now.in_a_row = 0
        tqdm.write(described(again, stop_when.confirm, sure))
        return sure

    def gait_misses(self, gaits: MotionSearch, frames: int) -> bool:
        """Look for a gait of a round of the warm-up that meets what would end the training; return whether none does.

        The fittest of the last gaits are evaluated in turn, and the first one that meets all conditions counts as the
        fittest; if none does, the one that meets most of them, and by return among equals. Where nothing ends the
        training, or gaits cannot be evaluated without a policy, none misses anything.

        Args:
            gaits: Gaits of the warm-up.
            frames: Frames so far.
        """
        stop_when = self.settings.stop_when
        if stop_when.evaluations is None:
            return False
        said, candidates = "", [*gaits.finalists[:CANDIDATES]]
        scores = dict[int | None, float]()
        for finalist in candidates or (None,):
            gaits.choose(finalist)
            metrics = self._measure_gait(gaits)
            if metrics is None:
                return False
            if not (missed := stop_when.missed(metrics)):
                self._record_gait(metrics)
                return False
            scores[finalist] = stop_when.score(metrics)
            said = said or f"{figures(metrics)}. It misses {', '.join(dict.fromkeys(missed))}."
        gaits.choose(max(scores, key=lambda finalist: scores[finalist]))
        tqdm.write(f"The fittest gait after {frames:,} frames: {said}")
        return True

    @property
    def knows_gait(self) -> bool:
        """Return whether the fittest gait of the warm-up is evaluated."""
        return (self.checkpoints.run / WARMUP_GAIT).exists()

    def _evaluate_gait(self, rhythm: Module | None) -> None:
        """Evaluate the warm-up's fittest gait without a policy, to see later what learning has added."""
        metrics = self._measure_gait(rhythm)
        if metrics is not None:
            self._record_gait(metrics)

    def _measure_gait(self, rhythm: Module | None) -> dict[str, float] | None:
        if not isinstance(rhythm, MotionSearch) or "film" not in self.task.abilities:
            return None
        gait = fittest_gait(rhythm, cast(SimulatedTask, self.task))
        if gait is None:
            return None
        return measure(gait, self.env, self.task, self.settings, self.settings.evaluation.seed)

    def _record_gait(self, metrics: Mapping[str, float]) -> None:
        tqdm.write(f"The fittest gait of the warm-up: {figures(metrics)}.")
        write_text(self.checkpoints.run / WARMUP_GAIT, json.dumps(metrics, indent=1) + "\n")

    def forget_gait(self) -> None:
        """Forget what the fittest gait reached: another warm-up follows."""
        (self.checkpoints.run / WARMUP_GAIT).unlink(missing_ok=True)

    def check_best(self, follows: bool) -> None:
        """Let the next policy count as the best one if the files of the best one so far are gone or damaged.

        Args:
            follows: Whether they are gone because a better one came, which is now made again.
        """
        if self.best is None:
            return
        try:
            checked(self.checkpoints.best())
        except RunError as error:
            lost, self.best = int(self.best["frames"]), None
            if follows:
                return
            print(
                f"The best policy so far, of {lost:,} steps, is lost: {error} The next one that is evaluated takes its "
                "place.",
                file=sys.stderr,
            )

    def figures(self, row: Mapping[str, float], diverged: int) -> dict[str, str]:
        """Return what the line of progress shows of an evaluation and of the best one so far."""
        best = self.best if self.best is not None else row
        shown = {
            "return": f"{row['return_mean']:.0f}",
            **({"success": f"{row['success_rate']:.0%}"} if "film" in self.task.abilities else {}),
            "best": f"{best['return_mean']:.0f}",
        }
        return {**shown, "diverged": str(diverged)} if diverged else shown
