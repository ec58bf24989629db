"""Collect while learning: workers step their shares of the robots while the learner learns.

Every worker is one of TorchRL's collectors with a single remote worker, so that one that dies or hangs can be replaced
while the others wait. All of them are asked for their next batch when the last ones are in, with the weights of that
moment. What comes is delivered a batch late: only when the next one is there is it known that no fault cut it short.
"""

from __future__ import annotations

import concurrent.futures
import copy
import multiprocessing
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import nn
from tqdm import tqdm

from gctd3.data.background import in_thread
from gctd3.data.exploration import Explorer
from gctd3.data.settings import ProcessSettings
from gctd3.data.worker import Job, Launch, Policy, Worker
from gctd3.envs.factory import EnvRecipe
from gctd3.errors import WorkerError

CLOSE = 20.0  # s, that workers may take to end


@dataclass
class _Slot:
    """Hold the place of a worker, and of those that replace it.

    Attributes:
        index: Number of the place.
        share: Robots of the worker.
        worker: Current worker; ``None`` while one starts.
        task: Batch that the worker is collecting.
        held: Last batch of the worker, to be delivered when the next one is there.
        started: Workers that have been started here.
        failures: Failures in a row, without a batch in between.
    """

    index: int
    share: slice
    worker: Worker | None = None
    task: concurrent.futures.Future[TensorDictBase] | None = None
    held: TensorDictBase | None = None
    started: int = 0
    failures: int = 0

    def ask(self, weights: TensorDictBase) -> None:
        """Ask for the next batch, with these weights."""
        if self.worker is not None:
            self.task = in_thread(partial(self.worker.next, weights))

    def cut(self) -> None:
        """End the episodes of the held batch, where they have not ended by themselves."""
        if self.held is not None:
            self.held = cut(self.held)


class WorkerCollector:
    """Deliver the batches that workers collect, all robots side by side.

    Args:
        workers: Settings of the workers: their number, and the limits on their time and failures.
        recipe: Recipe of the environment of all robots, of which each worker has a share.
        steps: Control steps of every robot in a batch.
        seed: Seed from which the workers' seeds are derived.
        explorer: Explorer of the learner. It does not act, but counts the frames of all; workers copy its actor.
        launch: Function that starts a worker.

    Attributes:
        latest: Last batch that was delivered.
        replaced: Workers that have been replaced so far.
    """

    def __init__(
        self,
        workers: ProcessSettings,
        recipe: EnvRecipe,
        steps: int,
        seed: int,
        explorer: Explorer,
        launch: Launch,
    ) -> None:
        self.workers, self.recipe, self.steps, self.seed, self.explorer = workers, recipe, steps, seed, explorer
        self._launch = launch
        self._slots = [_Slot(i, share) for i, share in enumerate(workers.shares(recipe.settings.num_envs))]
        self.latest: TensorDictBase = TensorDict({}, [])
        self.replaced = 0

    def collect(self) -> TensorDictBase:
        """Return the next steps, batch size ``[robots, steps]``.

        Raises:
            WorkerError: If a worker fails too often in a row.
        """
        weights = self._weights()
        for slot in self._slots:
            if slot.task is None:
                self._start(slot)
        for slot in self._slots:
            if slot.held is None:
                slot.held = self._wait(slot)
                slot.ask(weights)
        fresh = [self._wait(slot) for slot in self._slots]
        for slot in self._slots:
            slot.ask(weights)
        self.latest = _beside([slot.held for slot in self._slots])
        for slot, batch in zip(self._slots, fresh, strict=True):
            slot.held = batch
        self.explorer.frames += self.latest.numel()
        return self.latest

    def _weights(self) -> TensorDictBase:
        """Copy the actor's current weights, named as :class:`.Policy` has them."""
        return TensorDict.from_module(nn.ModuleDict({"actor": self.explorer.actor})).data.to("cpu").clone()

    def _start(self, slot: _Slot) -> concurrent.futures.Future[TensorDictBase]:
        """Start a new worker, which collects its first batch."""
        weights, frames = self._weights(), int(self.explorer.frames)
        # Every worker that is started gets a seed of its own, in a resumed run too.
        seed = int(np.random.SeedSequence([self.seed, slot.index, slot.started, frames]).generate_state(1)[0])
        actor, recipe = copy.deepcopy(self.explorer.actor).to("cpu").requires_grad_(False), self.recipe
        task, robots = recipe.task, recipe.settings.num_envs
        exploration = self.explorer.settings.in_workers
        explorer = Explorer.of_task(task, actor, robots, exploration, slot.share)
        explorer.frames.fill_(frames)
        job = Job(slot.share, seed, self.workers.cpus, self.steps, recipe, Policy(explorer))
        slot.worker, slot.started = None, slot.started + 1

        def begin(number: int = slot.started) -> TensorDictBase:
            worker = self._launch(job)
            if slot.started != number:  # it took too long, and another worker has its place
                worker.kill()
                raise WorkerError("replaced before it was ready")
            slot.worker = worker
            return worker.next(weights)

        slot.task = in_thread(begin)
        return slot.task

    def _wait(self, slot: _Slot) -> TensorDictBase:
        """Wait for the batch of the slot's worker, or of the one that takes its place."""
        while True:
            task = slot.task or self._start(slot)
            limit = self.workers.start_within if slot.worker is None else self.workers.timeout
            try:
                batch = task.result(limit)
            except concurrent.futures.TimeoutError:
                self._replace(slot, f"has delivered nothing for {limit:g} s")
            except Exception as error:
                lines = [line for line in str(error).splitlines() if line.strip()]
                self._replace(slot, f"failed ({lines[0].strip() if lines else type(error).__name__})")
            else:
                slot.failures = 0
                return batch

    def _replace(self, slot: _Slot, fault: str) -> None:
        if slot.worker is not None:
            slot.worker.kill()
        slot.cut()
        slot.failures += 1
        slot.task = None
        if slot.failures > self.workers.max_restarts:
            raise WorkerError(f"Worker {slot.index} {fault}, and has failed {slot.failures} times in a row")
        self.replaced += 1
        robots = slot.share.stop - slot.share.start
        line = f"Worker {slot.index} {fault}: another takes its place, and its {robots} robots start anew."
        tqdm.write(line, file=sys.stderr)
        self._start(slot)

    def follow(self, explorer: Explorer) -> None:
        """Continue with another explorer and new workers, and drop the batches that the old ones have not delivered."""
        self.close()
        self.explorer = explorer
        for slot in self._slots:
            slot.held = None

    def close(self) -> None:
        """End all workers; :meth:`collect` would start others."""
        closing, starting = [], any(slot.task is not None and slot.worker is None for slot in self._slots)
        for slot in self._slots:
            slot.started += 1  # a worker that is still starting ends itself
            slot.cut()
            if slot.worker is not None:
                closing.append(in_thread(slot.worker.close))
            slot.worker = slot.task = None
        if concurrent.futures.wait(closing, timeout=CLOSE).not_done or starting:
            # At its exit Python would wait for these processes, which nothing else ends.
            for process in multiprocessing.active_children():
                process.kill()

    def state_dict(self) -> dict[str, Any]:
        """Return the batches not delivered yet, all robots side by side; the robots' states are not known."""
        held = [slot.held for slot in self._slots if slot.held is not None]
        return {"held": _beside(held).to_dict() if len(held) == len(self._slots) else None}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state that :meth:`state_dict` returned; the episodes end there, and the robots start anew."""
        if state["held"] is not None:
            held = cut(TensorDict(state["held"]).auto_batch_size_(2))
            for slot in self._slots:
                slot.held = held[slot.share]


def cut(batch: TensorDictBase) -> TensorDictBase:
    """Return a copy of ``batch``, ``[robots, steps]``, with all unfinished episodes truncated at its last step."""
    batch = batch.clone()
    following = batch["next"]
    following["truncated"][:, -1] |= ~following["done"][:, -1]
    following["done"][:, -1] = True
    return batch


def _beside(parts: Sequence[TensorDictBase]) -> TensorDictBase:
    """Join the robots of all parts, in their order."""
    joined: TensorDictBase = torch.cat(tuple(parts))
    return joined
