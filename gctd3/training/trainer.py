"""Train a policy: collect, store, update, evaluate when it is time, and save the state to continue later."""

from __future__ import annotations

import contextlib
import logging
import math
import threading
import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl import torchrl_logger
from tqdm import tqdm

from gctd3.algorithms.base import Algorithm
from gctd3.config.build import again
from gctd3.config.fields import in_yaml
from gctd3.data.build_collector import build_collector
from gctd3.data.exploration import Explorer
from gctd3.data.finite import check_collected, check_losses
from gctd3.data.inline_collector import InlineCollector
from gctd3.data.mirror_augmentation import MirrorAugmentation
from gctd3.data.replay import Replay
from gctd3.envs.factory import EnvRecipe
from gctd3.errors import NumericalError, TrainingError, WorkerError
from gctd3.files import quoted
from gctd3.setup.setup import Setup
from gctd3.signals import StopRequest
from gctd3.training.checkpoint import Checkpoints, fit
from gctd3.training.confirmation import evaluation_env
from gctd3.training.device import pick_device
from gctd3.training.diagnosis import why_given_up
from gctd3.training.evaluations import Evaluations
from gctd3.training.gait_imitation import GaitImitation
from gctd3.training.give_up import Watch
from gctd3.training.initial_networks import begin_from
from gctd3.training.post_mortem import post_mortem
from gctd3.training.progress import Counters, ProgressLine
from gctd3.training.rng_state import load_random_state, random_state, seed_all
from gctd3.training.run_log import RunLog
from gctd3.training.settings import TrainSettings

FAILS = "the policy that begins as the warm-up's fittest gait misses the conditions."
MOST_TIME = 0.03  # share of the wall-clock that checkpoints may take


class Trainer:
    """Train a policy, from its settings to a directory full of results.

    Args:
        settings: Settings of the training.
        directory: Directory to write to.
        about: Further content of the manifests of checkpoints.
        setup: The robot, its task and the shape of its networks; built from the settings if ``None``.

    Attributes:
        evaluations: Its evaluations, with the metrics of the best one so far.
    """

    def __init__(
        self,
        settings: TrainSettings,
        directory: Path,
        about: Mapping[str, Any] | None = None,
        setup: Setup | None = None,
    ) -> None:
        self.settings, self.directory = settings, directory
        # Its notices of every storage and transform would break into the progress bar.
        torchrl_logger.setLevel(logging.WARNING)
        # A lock of this process alone: one of many processes would be reported as a leak if a signal ends this one.
        tqdm.set_lock(threading.RLock())
        if settings.threads is not None:
            torch.set_num_threads(settings.threads)
        # Before the networks, so that their initial weights are the seed's.
        seed_all(settings.seed)
        self.setup = setup = setup if setup is not None else settings.setup()
        task, env = setup.task, settings.env
        self.device = pick_device(settings.device)
        self.algorithm, self.explorer = self._new_learner()
        mirror = MirrorAugmentation(setup.reflection, task.history) if setup.mirrors(settings.replay.mirror) else None
        self.replay = Replay(settings.replay, settings.algo.gamma, task.history, mirror, self.device)
        self.gait_imitation = GaitImitation(settings, task, self.replay, self.device)
        recipe = EnvRecipe(task, env)
        self.collector = build_collector(settings.collector, recipe, settings.batch_steps, settings.seed, self.explorer)
        evaluated = settings.evaluation.episodes, settings.evaluation.seed
        robots = evaluation_env(settings, task, *evaluated, env.threads)
        manifest = {"graph": {"nodes": setup.graph.nodes, "edges": setup.graph.edges}, **(about or {})}
        self.checkpoints = Checkpoints(directory, settings.keep_checkpoints, manifest)
        self.log = RunLog(directory, settings.logger)
        self.evaluations = Evaluations(settings, task, robots, self.checkpoints, self.log)
        self.counters = Counters(next_evaluation=self._first_evaluation)
        self.watch = self._new_watch()
        self._clock = time.monotonic()
        self._next_save = settings.checkpoint_every

    def _new_learner(self) -> tuple[Algorithm, Explorer]:
        settings, task = self.settings, self.setup.task
        algorithm = settings.algo.build(self.setup.architecture(self.device))
        robots, exploration = settings.env.num_envs, settings.exploration_here
        return algorithm, Explorer.of_task(task, algorithm.actor, robots, exploration)

    def _new_watch(self) -> Watch:
        settings, frames = self.settings, self.settings.give_up.reward_frames
        # Tasks of other libraries have rewards that somebody has learnt from.
        judged = frames is not None and "film" in self.setup.task.abilities
        begin = max(frames, settings.exploration_here.learning_starts) if frames is not None and judged else None
        return Watch(settings.give_up, settings.env.num_envs, begin)

    def _begin_from_a_run(self) -> None:
        """Copy the networks of the run that ``init`` names, if it names one."""
        if self.settings.init is not None:
            begun = begin_from(self.algorithm, Path(self.settings.init), self.setup)
            self.gait_imitation.remember(self.algorithm)
            print(f"Networks begin as {quoted(self.settings.init)} had them after {begun.frames:,} frames.", flush=True)
            if begun.note:
                print(begun.note, flush=True)

    @property
    def _first_evaluation(self) -> int:
        return max(self.settings.evaluation.every, self.settings.exploration_here.learning_starts)

    @property
    def finished(self) -> bool:
        """Return whether all frames or episodes are collected, or enough evaluations in a row met all conditions."""
        settings, now = self.settings, self.counters
        return settings.stop_when.ends_after(now.in_a_row) or self._spent

    @property
    def _spent(self) -> bool:
        settings, now = self.settings, self.counters
        over = now.frames + settings.batch_frames > settings.total_frames
        return over or now.episodes >= (settings.total_episodes or math.inf)

    def run(self, stop: StopRequest | None = None) -> dict[str, float] | None:
        """Train until it is finished, ``stop`` is set or ``time_limit`` is over.

        Returns:
            The metrics of the best evaluation; ``None`` without an evaluation.

        Raises:
            NumericalError: If an observation, action, reward or loss is not finite.
            RunError: If a checkpoint cannot be written.
            TrainingError: If the first batches show that it cannot succeed, see :class:`.GiveUp`.
            WorkerError: If a worker fails too often in a row; a checkpoint is written before.
        """
        if self.counters.frames == 0:
            self._begin_from_a_run()
        self._clock = began = time.monotonic()
        limit = math.inf if self.settings.time_limit is None else 60.0 * self.settings.time_limit
        with (
            self.log,
            contextlib.closing(self.collector),
            ProgressLine(self.settings.total_frames, self.counters.frames) as line,
        ):
            try:
                while not self.finished and not stop and time.monotonic() - began < limit:
                    self._iterate(line)
                    if self._wall() >= self._next_save:
                        self.save()
            except WorkerError as error:
                self.save()
                command = again(in_yaml(self.settings), "train", f"resume={self.directory}")
                raise WorkerError(f"{error}. Continue it:  {command}") from error
            self.save()
        self.evaluations.env.close(raise_if_closed=False)
        return self.evaluations.best

    def _iterate(self, line: ProgressLine) -> None:
        """Collect, update, and evaluate if it is time."""
        seen: dict[str, TensorDictBase] = {}
        try:
            self._learn(line, seen)
        except NumericalError as error:
            latest = {"collected": self.collector.latest, **seen}
            raise post_mortem(self.directory, error, self.counters, latest, self.state_dict()) from error

    def _learn(self, line: ProgressLine, seen: dict[str, TensorDictBase]) -> None:
        settings, now = self.settings, self.counters
        demonstrates = self.gait_imitation.demonstrates(self.explorer)
        seen["collected"] = collected = self.collector.collect()
        check_collected(collected)
        if demonstrates:
            self.gait_imitation.demonstration.add(collected)
        if self.explorer.round_over:
            frames = now.frames + collected.numel()
            if self.gait_imitation.ends_warmup(self.explorer, self.evaluations, frames):
                now.next_evaluation = frames
        robots = self.gait_imitation.anew(self.explorer)
        if robots is not None and isinstance(self.collector, InlineCollector):
            self.collector.begin_anew(collected, robots)
        self.replay.extend(collected)
        metrics: dict[str, Tensor] = {}
        if not self.explorer.warming_up and self.replay.ready:
            if not self.algorithm.updates:
                self.gait_imitation.choose(self.explorer, self.evaluations, now.frames + collected.numel())
                difference = self.gait_imitation.begin(self.algorithm, self.explorer)
                if difference is not None:
                    alike = f"mean squared difference {difference:.1e}"
                    tqdm.write(f"The policy begins as the warm-up's fittest gait ({alike}).")
            for _ in range(settings.batch_updates):
                seen["batch"] = self.replay.sample()
                metrics = self.algorithm.update(seen["batch"])
            now.updates += settings.batch_updates
            check_losses(metrics)
        now.frames += collected.numel()
        now.episodes += int(collected["next", "done"].sum())
        now.diverged += int(collected["next", "diverged"].sum())
        line.advance(collected.numel())
        if (failure := self.watch.judge(collected, now.frames)) is not None:
            raise TrainingError(why_given_up(failure, self.watch.seen, settings, self.setup.task, now.frames))
        if now.frames < now.next_evaluation and not self._spent:
            return
        now.next_evaluation += settings.evaluation.every
        row = self._evaluate()
        self.log.scalars({f"train/{name}": float(value) for name, value in metrics.items()}, now.frames)
        line.evaluated(self.evaluations.figures(row, now.diverged))
        fails = not self._spent and self.gait_imitation.failed(self.algorithm, now.in_a_row)
        if fails and (left := self.gait_imitation.resumes_warmup(self.explorer, now.frames)):
            self._warm_up_on(line, left)
        elif fails and self.gait_imitation.gives_up(now.restarts):
            self._begin_again(line, FAILS)
        elif settings.stop_when.all_reached(row):
            now.promising = now.frames
        elif now.frames - now.promising >= (settings.stop_when.restart_after or math.inf) and not self._spent:
            self._begin_again(line, f"no evaluation in {now.frames - now.promising:,} met all conditions.")

    def _warm_up_on(self, line: ProgressLine, frames: int) -> None:
        """Go on with the warm-up for so many frames at most; a new policy then begins as its fittest gait."""
        line.write(f"After {self.counters.frames:,} frames: {FAILS} Gaits evolve on; the best policy is kept.")
        self.algorithm = self.settings.algo.build(self.setup.architecture(self.device))
        self.explorer.actor = self.algorithm.actor
        self.counters.next_evaluation = self.counters.frames + frames
        self.evaluations.forget_gait()

    def _begin_again(self, line: ProgressLine, why: str) -> None:
        """Begin again with new weights, an empty replay and a new warm-up."""
        now = self.counters
        line.write(f"After {now.frames:,} frames: {why} It begins again with new weights; the best policy is kept.")
        self.algorithm, self.explorer = self._new_learner()
        self._begin_from_a_run()
        self.collector.follow(self.explorer)
        self.replay.clear()
        self.gait_imitation.demonstration.clear()
        self.evaluations.forget_gait()
        now.restarts, now.promising = now.restarts + 1, now.frames
        now.next_evaluation = now.frames + self._first_evaluation

    def _evaluate(self) -> dict[str, float]:
        return self.evaluations.evaluate(self.algorithm.policy(), self.explorer.rhythm, self.counters, self._wall)

    def _wall(self) -> float:
        return self.counters.wall_s + time.monotonic() - self._clock

    # Saving and restoring the state.

    def save(self) -> None:
        """Write a checkpoint."""
        began = time.monotonic()
        self.checkpoints.save(self.counters.frames, self.state_dict(), self.replay.buffer)
        cost = time.monotonic() - began
        self._next_save = self._wall() + max(self.settings.checkpoint_every, cost / MOST_TIME)

    def restore(self) -> bool:
        """Continue from the newest checkpoint that is whole.

        Returns:
            Whether there was one; without, the training starts from its beginning.

        Raises:
            RunError: If all are damaged or do not fit the settings.
        """
        newest = self.checkpoints.newest()
        if newest is None:
            self.checkpoints.forget_after(-1)
            self.log.restore([], -1)
            return False
        state, rows = newest
        path = self.checkpoints.directory
        fit(path, lambda: self.replay.load_state_dict(state.pop("replay"), rows))
        fit(path, lambda: self.load_state_dict(state))
        self.evaluations.check_best(self.checkpoints.forget_after(self.counters.frames))
        return True

    def state_dict(self) -> dict[str, Any]:
        """Return the state that the rest of the training depends on, without the replay."""
        return {
            "counters": {**asdict(self.counters), "wall_s": self._wall()},
            "best": self.evaluations.best,
            "rows": self.log.rows,
            "algorithm": self.algorithm.state_dict(),
            "explorer": self.explorer.state_dict(),
            "demonstration": self.gait_imitation.state_dict(),
            "collector": self.collector.state_dict(),
            "watch": self.watch.state_dict(),
            "random": random_state(self.device),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state that :meth:`state_dict` returned."""
        self.counters = Counters(**state["counters"])
        self.evaluations.best = state["best"]
        self.log.restore(state["rows"], self.counters.frames)
        self.algorithm.load_state_dict(state["algorithm"])
        self.explorer.load_state_dict(state["explorer"])
        self.gait_imitation.load_state_dict(state.get("demonstration"), self.algorithm)
        if self.algorithm.updates:
            self.gait_imitation.follow(self.algorithm, self.explorer)
        self.collector.load_state_dict(state["collector"])
        self.watch.load_state_dict(state.get("watch"))
        load_random_state(state["random"], self.device)
        self._clock = time.monotonic()
        self._next_save = self._wall() + self.settings.checkpoint_every
