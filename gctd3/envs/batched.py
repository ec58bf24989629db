"""N robots as one TorchRL environment of batch size [N]."""

from __future__ import annotations

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from gctd3.envs.gait import FEATURES
from gctd3.envs.simulation import Simulation


class BatchedEnv(EnvBase):
    """The walking task on ``simulation.num_robots`` robots, all stepped at once.

    Args:
        simulation: The robots.

    Writes, with leading dimension ``[N]``: ``nodes [nodes, 2]``, ``counters [2 * feet]``, ``position [1]`` (m),
    ``success [1]``, ``diverged [1]``, TorchRL's reward and done keys, and what :class:`torchrl.envs.InitTracker` and
    :class:`torchrl.envs.StepCounter` would: ``is_init [1]``, ``step_count [1]``. Actions: ``[A]`` in [-1, 1].
    """

    def __init__(self, simulation: Simulation) -> None:
        n, task = simulation.num_robots, simulation.task
        super().__init__(batch_size=torch.Size([n]))
        self.simulation = simulation
        self.observation_spec = Composite(
            nodes=Unbounded((n, len(task.nodes), FEATURES)),
            counters=Unbounded((n, task.num_counters)),
            position=Unbounded((n, 1)),
            success=Binary(1, shape=(n, 1), dtype=torch.bool),
            diverged=Binary(1, shape=(n, 1), dtype=torch.bool),
            is_init=Binary(1, shape=(n, 1), dtype=torch.bool),
            step_count=Bounded(low=0, high=torch.iinfo(torch.int64).max, shape=(n, 1), dtype=torch.int64),
            shape=(n,),
        )
        self.action_spec = Bounded(low=-1.0, high=1.0, shape=(n, len(task.robot.actuated)))
        self.reward_spec = Unbounded((n, 1))
        done = Binary(1, shape=(n, 1), dtype=torch.bool)
        self.done_spec = Composite(done=done, terminated=done.clone(), truncated=done.clone(), shape=(n,))

    def _observe(self, success: np.ndarray, diverged: np.ndarray, is_init: np.ndarray) -> dict[str, torch.Tensor]:
        simulation = self.simulation
        return {
            "nodes": torch.from_numpy(simulation.task.node_features(simulation.now)),
            "counters": torch.from_numpy(simulation.task.counters(simulation.progress)),
            "position": _column(simulation.now.position.astype(np.float32)),
            "success": _column(success),
            "diverged": _column(diverged),
            "is_init": _column(is_init),
            "step_count": _column(simulation.progress.step.copy()),
        }

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDictBase:
        mask = np.ones(self.simulation.num_robots, dtype=bool)
        if tensordict is not None and (chosen := tensordict.get("_reset", None)) is not None:
            mask = chosen.reshape(-1).cpu().numpy()
        self.simulation.reset(mask)
        nothing = np.zeros(len(mask), dtype=bool)
        return TensorDict({**self._observe(nothing, nothing, mask), **_done(nothing, nothing)}, self.batch_size)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        outcome = self.simulation.step(tensordict.get("action").detach().cpu().numpy().astype(np.float64))
        return TensorDict(
            {
                **self._observe(outcome.success, outcome.diverged, np.zeros_like(outcome.success)),
                **_done(outcome.terminated, outcome.truncated),
                "reward": _column(outcome.reward.astype(np.float32)),
            },
            self.batch_size,
        )

    def _set_seed(self, seed: int | None) -> None:
        self.simulation.rng = np.random.default_rng(seed)


def _column(values: np.ndarray) -> torch.Tensor:
    # NumPy's is several times quicker than PyTorch's. By indexing the stride would be 0, on which torch.stack dies.
    return torch.from_numpy(values.reshape(-1, 1))


def _done(terminated: np.ndarray, truncated: np.ndarray) -> dict[str, torch.Tensor]:
    return {
        "done": _column(terminated | truncated),
        "terminated": _column(terminated),
        "truncated": _column(truncated),
    }
