"""Run many episodes of one policy and summarise them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from gctd3.data.finite import check_finite
from gctd3.envs.robots_env import Glance
from gctd3.evaluation.episode import Episode
from gctd3.evaluation.jumping import jump_errors
from gctd3.evaluation.recorder import Recorder
from gctd3.evaluation.tracking import tracking_errors
from gctd3.progress import StatusLine
from gctd3.tasks.task import Task


@dataclass(frozen=True)
class Evaluation:
    """Hold many episodes of one policy.

    Attributes:
        episodes: The episodes.
        control_dt: Control period (s).
    """

    episodes: list[Episode]
    control_dt: float

    @property
    def returns(self) -> np.ndarray:
        """Return the undiscounted return of each episode, shape ``[episodes]``."""
        return np.array([episode.reward.sum() for episode in self.episodes])

    def summary(self) -> dict[str, float | int]:
        """Summarise the episodes by means over them; ``return_std`` is the standard deviation of their returns."""
        episodes = self.episodes
        return {
            "episodes": len(episodes),
            "return_mean": float(self.returns.mean()),
            "return_std": float(self.returns.std()),
            "velocity_mean": float(np.mean([e.velocity(self.control_dt) for e in episodes])),
            "distance_mean": float(np.mean([e.position[-1] for e in episodes])),
            "success_rate": float(np.mean([e.success for e in episodes])),
            "body_position_mean": float(np.mean(np.concatenate([e.height for e in episodes]))),
            **tracking_errors(episodes, self.control_dt),
            **jump_errors(episodes),
        }

    def by_ground(self) -> list[dict[str, str | float | int]]:
        """Summarise the episodes on each kind and level of terrain; empty on a plane."""
        groups: dict[tuple[str, int], list[Episode]] = {}
        for episode in self.episodes:
            if episode.ground is not None:
                groups.setdefault(episode.ground, []).append(episode)
        return [
            {
                "kind": kind,
                "level": level,
                "episodes": len(episodes),
                "success_rate": float(np.mean([e.success for e in episodes])),
                "fall_rate": float(np.mean([e.fell for e in episodes])),
                "distance_mean": float(np.mean([e.position[-1] for e in episodes])),
            }
            for (kind, level), episodes in sorted(groups.items())
        ]

    @property
    def typical(self) -> Episode:
        """Return the episode with the median return, or the one just below."""
        return self.episodes[int(np.argsort(self.returns, kind="stable")[(len(self.episodes) - 1) // 2])]

    def gait(self) -> dict[str, float]:
        """Average gait metrics of the last 10 m over the episodes that got that far; empty if none did."""
        gaits = [gait for e in self.episodes if (gait := e.gait(self.control_dt)) is not None]
        if not gaits:
            return {}
        averages = {key: float(np.mean([gait[key] for gait in gaits])) for key in gaits[0]}
        return {"episodes": len(gaits), **averages}


def evaluate(
    policy: TensorDictModuleBase,
    env: EnvBase,
    task: Task,
    seed: int,
    record: bool = False,
    line: StatusLine | None = None,
) -> Evaluation:
    """Run one episode on every robot of ``env``.

    Args:
        policy: Policy that reads ``"nodes"`` and writes ``"action"``; its mode is taken if it is stochastic.
        env: Environment from :func:`gctd3.envs.factory.build_env`, batch size ``[episodes]``.
        task: The task of the robots.
        seed: Seed of the starts: equal seeds, equal starts.
        record: Whether to keep each episode's motion; only for the batched backend.
        line: Where to show how far it is, if anywhere.

    Raises:
        NumericalError: If an action of the policy is not finite.
    """
    count, robot = env.batch_size[0], task.robot
    alive = torch.ones(count, dtype=torch.bool)
    frames: list[tuple[torch.Tensor, ...]] = []
    glances: list[Glance] = []
    terminated = torch.zeros(count, dtype=torch.bool)
    # TorchRL seeds the global generator along with the environment's: a fork keeps that out of the training.
    with torch.random.fork_rng(devices=[]), torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        env.set_seed(seed)
        state = env.reset()
        recorder = Recorder(robot, env.base_env.simulation) if record else None
        commands = [env.base_env.glance().command]
        grounds = env.base_env.lanes()
        while alive.any():
            acting = policy(state)
            check_finite("action", acting["action"])
            state = env.step(acting)
            if recorder is not None:
                recorder.add(acting["action"].numpy().astype(np.float64))
            after = state["next"]
            glances.append(env.base_env.glance())
            commands.append(glances[-1].command)
            terminated |= alive & after["terminated"][:, 0]
            frames.append((alive, after["reward"][:, 0], after["position"][:, 0], after["success"][:, 0]))
            alive = alive & ~after["done"][:, 0]
            if line is not None:
                done = count - int(alive.sum())
                line.show(f"evaluating: {len(frames):,} control steps, {done} of {count} episodes have ended")
            state = step_mdp(state)
    lived, reward, position, success = (torch.stack(column).numpy() for column in zip(*frames, strict=True))
    # As precise as the policies' observations.
    height = np.stack([glance.height for glance in glances]).astype(np.float32)
    hips = np.stack([glance.hips for glance in glances]).astype(np.float32).astype(np.float64)
    feet_down = np.stack([glance.feet_down for glance in glances])
    # The command that was seen when the action was chosen: that before the step.
    asked = _stacked(commands[:-1])
    moved = _stacked([glance.moved for glance in glances])
    jumps = _stacked([glance.jump for glance in glances])
    lengths = [int(steps) for steps in lived.sum(axis=0)]
    motions = recorder.motions(lengths) if recorder is not None else [None] * count
    episodes = []
    for i, steps in enumerate(lengths):
        episodes.append(
            Episode(
                reward=reward[:steps, i].astype(np.float64),
                position=position[:steps, i],
                height=height[:steps, i],
                hips=hips[:steps, i],
                feet_down=feet_down[:steps, i],
                pairs=tuple((one, other) for one, other in enumerate(robot.mirror_feet) if one < other),
                success=bool(success[:steps, i].any()),
                motion=motions[i],
                command=None if asked is None else asked[:steps, i],
                moved=None if moved is None else moved[:steps, i],
                fell=bool(terminated[i]),
                jump=None if jumps is None else (float(jumps[steps - 1, i, 0]), float(jumps[steps - 1, i, 1])),
                ground=None if grounds is None else grounds[i],
            )
        )
    return Evaluation(episodes, task.control_dt)


def _stacked(values: list[np.ndarray | None]) -> np.ndarray | None:
    known = [value for value in values if value is not None]
    return np.stack(known) if known else None
