"""N robots as one TorchRL environment of batch size [N]."""

from __future__ import annotations

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase

from gctd3.envs.robots_env import RobotsEnv, column, ends
from gctd3.envs.simulation import Simulation
from gctd3.tasks.walk import FEATURES


class BatchedEnv(RobotsEnv):
    """The walking task on ``simulation.num_robots`` robots, all stepped at once.

    Args:
        simulation: The robots.

    Writes ``nodes [nodes, 2]`` and ``counters [2 * feet]`` of each; the rest as every :class:`.RobotsEnv`.
    """

    def __init__(self, simulation: Simulation) -> None:
        task = simulation.task
        nodes = len(task.nodes), FEATURES
        super().__init__(simulation.num_robots, nodes, task.num_counters, len(task.robot.actuated))
        self.simulation = simulation

    def _observe(self, success: np.ndarray, diverged: np.ndarray, is_init: np.ndarray) -> dict[str, torch.Tensor]:
        simulation = self.simulation
        return {
            "nodes": torch.from_numpy(simulation.task.node_features(simulation.now)),
            "counters": torch.from_numpy(simulation.task.counters(simulation.progress)),
            "position": column(simulation.now.position.astype(np.float32)),
            "success": column(success),
            "diverged": column(diverged),
            "is_init": column(is_init),
            "step_count": column(simulation.progress.step.copy()),
        }

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDictBase:
        mask = self.chosen(tensordict)
        self.simulation.reset(mask)
        nothing = np.zeros(len(mask), dtype=bool)
        return TensorDict({**self._observe(nothing, nothing, mask), **ends(nothing, nothing)}, self.batch_size)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        outcome = self.simulation.step(tensordict.get("action").detach().cpu().numpy().astype(np.float64))
        return TensorDict(
            {
                **self._observe(outcome.success, outcome.diverged, np.zeros_like(outcome.success)),
                **ends(outcome.terminated, outcome.truncated),
                "reward": column(outcome.reward.astype(np.float32)),
            },
            self.batch_size,
        )

    def _set_seed(self, seed: int | None) -> None:
        self.simulation.rng = np.random.default_rng(seed)
