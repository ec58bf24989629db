"""A worker somewhere on a Ray cluster: TorchRL's Ray collector, weights by its scheme over torch.distributed."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator

import ray
from tensordict import TensorDictBase
from torchrl.collectors.distributed import RayCollector
from torchrl.weight_update import RayWeightSyncScheme

from gctd3.data.worker import Job, Worker


class RayWorker(Worker):
    """Run a worker as one actor of a Ray cluster, which is joined already."""

    def __init__(self, job: Job) -> None:
        self._scheme = RayWeightSyncScheme()
        self._collector = RayCollector(
            [job.make_env],
            job.policy,
            frames_per_batch=job.frames,
            total_frames=sys.maxsize,
            device="cpu",
            sync=True,
            trust_policy=True,
            weight_sync_schemes={"policy": self._scheme},
            collector_kwargs=[{"auto_register_policy_transforms": False}],
            # The learner restarts it, with other seeds.
            remote_configs=[{"num_cpus": job.cpus, "num_gpus": 0, "max_restarts": 0}],
        )
        self._batches: Iterator[TensorDictBase] | None = None

    def next(self, weights: TensorDictBase) -> TensorDictBase:
        """Return the next batch, ``[robots, steps]``, collected with these weights."""
        self._collector.update_policy_weights_(weights)
        if self._batches is None:  # TorchRL warns if there are no weights yet
            self._batches = iter(self._collector)
        batch = next(self._batches).squeeze(0).exclude("collector")
        batch.names = None
        return batch

    def kill(self) -> None:
        """End the actor at once."""
        # TorchRL's list of actors has to be empty, and its scheme shut down: what is left of them is killed again when
        # they are deleted, and if Python is ending by then, Ray first starts another cluster for that, and waits
        # forever.
        with contextlib.suppress(Exception):
            self._scheme.shutdown()
        actors = self._collector.remote_collectors
        while actors:
            with contextlib.suppress(Exception):  # there may be no cluster left to ask
                ray.kill(actors.pop(), no_restart=True)

    def close(self) -> None:
        """Let the actor end."""
        with contextlib.suppress(Exception):
            self._collector.shutdown()
        self.kill()  # in case the shutdown failed before it ended the actor
