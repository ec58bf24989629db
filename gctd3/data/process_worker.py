"""A worker in a process of its own on this machine: TorchRL's multi-process collector, weights in shared memory."""

from __future__ import annotations

import contextlib
import queue
import signal
from collections.abc import Iterator
from multiprocessing import resource_tracker
from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.collectors import MultiSyncCollector
from torchrl.weight_update import SharedMemWeightSyncScheme

from gctd3.compat import AnswerHook
from gctd3.data.worker import Job, Worker
from gctd3.signals import SIGNALS


class _Scheme(AnswerHook, SharedMemWeightSyncScheme):
    """Send weights as TorchRL does, but do not wait for ever for a dead worker."""

    def await_answer(self, answers: Any) -> None:  # noqa: ANN401 - a queue
        """Wait for the worker to say that it has the weights, as long as it lives."""
        while self.context.procs[0].is_alive():
            with contextlib.suppress(queue.Empty):
                answers.get(timeout=0.2)
                return


@contextlib.contextmanager
def _signals_ignored_by_children() -> Iterator[None]:
    """Shield processes begun meanwhile from Ctrl-C and SIGTERM, which go to a whole process group.

    The learner tells its workers when to end. Signals that this thread blocks reach another
    thread of the process.
    """
    # Python's own helper process would be started with the first child, and that unblocks them.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class ProcessWorker(Worker):
    """Run a worker in a process on this machine; the constructor returns once it is ready."""

    def __init__(self, job: Job) -> None:
        with _signals_ignored_by_children():
            self._collector = MultiSyncCollector(
                [job.make_env],
                job.policy,
                frames_per_batch=job.frames,
                total_frames=-1,
                device="cpu",
                cat_results=0,
                use_buffers=True,
                trust_policy=True,
                auto_register_policy_transforms=False,
                # TorchRL's collector sets the learner's number of threads too.
                num_threads=torch.get_num_threads(),
                num_sub_threads=job.cpus,
                weight_sync_schemes={"policy": _Scheme()},
            )
        self._batches = iter(self._collector)

    @property
    def pid(self) -> int:
        """Return the ID of the process."""
        return int(self._collector.procs[0].pid)

    def next(self, weights: TensorDictBase) -> TensorDictBase:
        """Return the next batch, ``[robots, steps]``, collected with these weights."""
        self._collector.update_policy_weights_(weights)
        batch = next(self._batches).exclude("collector")
        batch.names = None
        return batch

    def kill(self) -> None:
        """End the process at once."""
        for process in self._collector.procs:
            with contextlib.suppress(ValueError):  # the process is closed already
                process.kill()
        self.close()

    def close(self) -> None:
        """Let the process end."""
        threads = torch.get_num_threads()
        self._collector.shutdown(timeout=10.0, raise_on_error=False)
        torch.set_num_threads(threads)  # shutdown sets the learner's number to the worker's
