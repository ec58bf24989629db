"""A simulated task as a TorchRL environment of batch size [N]: TorchRL is crossed once per step of all robots."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase

from gctd3.envs.robots_env import Glance, RobotsEnv, column, ends
from gctd3.envs.simulation import Simulation
from gctd3.tasks.ground import LANE
from gctd3.tasks.jump_memory import jumped
from gctd3.tasks.terminations import STEPS
from gctd3.tasks.terms import hips
from gctd3.tasks.velocity_command import VELOCITY, velocities


class BatchedEnv(RobotsEnv):
    """Step a task on ``simulation.num_robots`` robots, all at once.

    Args:
        simulation: The simulation of the robots.

    Writes ``nodes [nodes, F]`` and ``counters [K]`` of each robot, and the other keys of every :class:`.RobotsEnv`.
    """

    def __init__(self, simulation: Simulation) -> None:
        task = simulation.task
        nodes = task.graph.num_nodes, task.features
        super().__init__(simulation.num_robots, nodes, task.num_counters, task.facts.actions)
        self.simulation = simulation

    def _observe(self, success: np.ndarray, diverged: np.ndarray, is_init: np.ndarray) -> dict[str, torch.Tensor]:
        simulation = self.simulation
        return {
            "nodes": torch.from_numpy(simulation.task.node_features(simulation.now, simulation.memory)),
            "counters": torch.from_numpy(simulation.task.counters(simulation.memory, simulation.now)),
            "position": column(simulation.now.position.astype(np.float32)),
            "success": column(success),
            "diverged": column(diverged),
            "is_init": column(is_init),
            "step_count": column(simulation.memory[STEPS].copy()),
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

    def glance(self) -> Glance:
        """Return the present measurements of the robots."""
        now, facts = self.simulation.now, self.simulation.task.facts
        command = self.simulation.memory.get(VELOCITY)
        moved = None if command is None else velocities(now, facts)
        jump = jumped(self.simulation.memory)
        return Glance(now.height, hips(now, facts) * facts.hip_signs, now.feet_down, command, moved, jump)

    def lanes(self) -> list[tuple[str, int]] | None:
        """Return the kind and the level of the ground on which each robot's episode began; ``None`` on a plane."""
        ground = self.simulation.task.ground
        return None if ground is None else [ground.describe(int(lane)) for lane in self.simulation.memory[LANE]]

    def checkpoint(self) -> dict[str, Any]:
        """Return the simulation's state."""
        return self.simulation.state_dict()

    def restore(self, state: dict[str, Any]) -> None:
        """Restore the simulation's state."""
        self.simulation.load_state_dict(state)
