"""Judge a policy: ``python -m gctd3.evaluate run=DIR episodes=50``."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import torch
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from gctd3 import gait_metrics
from gctd3.envs.factory import build_env
from gctd3.envs.gait import FEATURES, Reward
from gctd3.errors import ConfigError
from gctd3.robot import Robot

LAST_METRES = 10.0  # over which gaits are judged, so that the start does not count


@dataclass(frozen=True)
class Episode:
    """One episode, as it was; ``T`` is its number of steps.

    Attributes:
        reward: Shape ``[T]``.
        position: Distance walked, shape ``[T]`` (m).
        height: Body height from standing, shape ``[T]`` (m).
        hips: Hip angles, one column per foot, shape ``[T, feet]`` (rad).
        feet_down: Contacts, shape ``[T, feet]``.
        success: Whether it reached the finish.
    """

    reward: np.ndarray
    position: np.ndarray
    height: np.ndarray
    hips: np.ndarray
    feet_down: np.ndarray
    success: bool

    def velocity(self, dt: float) -> float:
        """Distance over time (m/s)."""
        return float(self.position[-1]) / (len(self.position) * dt)

    def gait(self, dt: float) -> dict[str, float] | None:
        """Metrics over the last 10 m; ``None`` if it did not get that far."""
        walked = self.position > self.position[-1] - LAST_METRES
        if self.position[-1] < LAST_METRES or walked.sum() < 2:
            return None
        flight, single, double = gait_metrics.support_fractions(self.feet_down[walked])
        return {
            "hip_correlation": gait_metrics.correlation(self.hips[walked, 0], self.hips[walked, 1]),
            "stride_hz": gait_metrics.stride_frequency(self.feet_down[walked], dt),
            "flight_fraction": flight,
            "single_support_fraction": single,
            "double_support_fraction": double,
            "height_rms": float(np.sqrt(np.mean((self.height[walked] - self.height[walked].mean()) ** 2))),
        }


@dataclass(frozen=True)
class Evaluation:
    """Many episodes of one policy.

    Attributes:
        episodes: The episodes.
        control_dt: Control period (s).
    """

    episodes: list[Episode]
    control_dt: float

    @property
    def returns(self) -> np.ndarray:
        """Shape ``[episodes]``."""
        return np.array([episode.reward.sum() for episode in self.episodes])

    def summary(self) -> dict[str, float | int]:
        """The headline numbers: means over episodes, ``return_std`` their standard deviation."""
        episodes = self.episodes
        return {
            "episodes": len(episodes),
            "return_mean": float(self.returns.mean()),
            "return_std": float(self.returns.std()),
            "velocity_mean": float(np.mean([e.velocity(self.control_dt) for e in episodes])),
            "distance_mean": float(np.mean([e.position[-1] for e in episodes])),
            "success_rate": float(np.mean([e.success for e in episodes])),
            "body_position_mean": float(np.mean(np.concatenate([e.height for e in episodes]))),
        }

    def gait(self) -> dict[str, float]:
        """Gait metrics over the last 10 m, averaged over the episodes that got that far; empty if none did."""
        gaits = [gait for e in self.episodes if (gait := e.gait(self.control_dt)) is not None]
        if not gaits:
            return {}
        averages = {key: float(np.mean([gait[key] for gait in gaits])) for key in gaits[0]}
        return {"episodes": len(gaits), **averages}


def evaluate(policy: TensorDictModuleBase, env: EnvBase, robot: Robot, seed: int, control_dt: float) -> Evaluation:
    """Run one episode on every robot of ``env``.

    Args:
        policy: Reads ``"nodes"``, writes ``"action"``; its mode is taken if it is stochastic.
        env: Of :func:`gctd3.envs.factory.build_env`, batch size ``[episodes]``.
        robot: Its robot.
        seed: Of the starts: equal seeds, equal starts.
        control_dt: Control period (s).
    """
    names = list(_node_names(robot))
    hips = [names.index(leg[0].name) for leg in robot.legs]
    count = env.batch_size[0]
    alive = torch.ones(count, dtype=torch.bool)
    frames: list[tuple[torch.Tensor, ...]] = []
    # TorchRL seeds the global generator along with the environment's: a fork keeps that out of the training.
    with torch.random.fork_rng(devices=[]), torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        env.set_seed(seed)
        state = env.reset()
        while alive.any():
            state = env.step(policy(state))
            after = state["next"]
            newest = after["nodes"][..., -FEATURES:]
            frames.append((alive, after["reward"][:, 0], after["position"][:, 0], newest, after["success"][:, 0]))
            alive = alive & ~after["done"][:, 0]
            state = step_mdp(state)
    lived, reward, position, nodes, success = (torch.stack(column).numpy() for column in zip(*frames, strict=True))
    episodes = []
    for i in range(count):
        steps = int(lived[:, i].sum())
        mine = nodes[:steps, i]
        episodes.append(
            Episode(
                reward=reward[:steps, i].astype(np.float64),
                position=position[:steps, i],
                height=mine[:, 0, 0],
                hips=mine[:, hips, 0],
                feet_down=mine[:, -1] > 0.5,
                success=bool(success[:steps, i].any()),
            )
        )
    return Evaluation(episodes, control_dt)


def _node_names(robot: Robot) -> tuple[str, ...]:
    from gctd3.graph import KinematicGraph

    return KinematicGraph.from_robot(robot).nodes
