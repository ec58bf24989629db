"""Notice in its first batches that a training cannot succeed: it diverges, ends at once, or rewards nothing."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from gctd3.errors import check_between

# Settings import no PyTorch.
if TYPE_CHECKING:
    from tensordict import TensorDictBase
    from torch import Tensor


@dataclass(frozen=True)
class GiveUp:
    """Hold the signs by which a training that cannot succeed is ended within its first batches.

    Attributes:
        episodes: First episodes of a training that are judged; ``None`` for none of them. 50 come within the first
            minute; a robot that works does not even diverge in one of a thousand.
        share: Share of them that must have failed in one way: diverged, or been too short. It is high, since a policy
            learns from the rest of them.
        steps: An episode that terminates within so many control steps was too short for an action to matter. With
            random actions, the robots that come with gctd3 terminate after 10 or more, Gymnasium's Walker2d after 6.
        reward_frames: Frames after which rewards must have differed, or returns of episodes; ``None`` for never. It is
            judged once exploration.learning_starts is over too, and not for tasks of other libraries, some of which
            reward nothing for long.
    """

    episodes: int | None = 50
    share: float = 0.9
    steps: int = 2
    reward_frames: int | None = 10_000

    def __post_init__(self) -> None:
        check_between(self, 1, 10**6, "episodes", "steps")
        check_between(self, 0.5, 1.0, "share")
        check_between(self, 1, 10**12, "reward_frames")


@dataclass
class Seen:
    """Count what the first batches of a training showed.

    Attributes:
        episodes: Episodes that ended.
        diverged: Of them those whose simulation failed.
        short: Of them those that terminated within :attr:`GiveUp.steps`.
        reward_low: Lowest reward of a step.
        reward_high: Highest reward of a step.
        return_low: Lowest return of an episode.
        return_high: Highest return of an episode.
    """

    episodes: int = 0
    diverged: int = 0
    short: int = 0
    reward_low: float = math.inf
    reward_high: float = -math.inf
    return_low: float = math.inf
    return_high: float = -math.inf


DIVERGED, SHORT, EQUAL = "diverged", "short", "equal"


class Watch:
    """Evaluate the first batches of a training.

    Args:
        settings: The signs.
        robots: Number of robots.
        rewards_from: Frames from which on rewards are judged; ``None`` for never.

    Attributes:
        seen: Counts so far.
    """

    def __init__(self, settings: GiveUp, robots: int, rewards_from: int | None) -> None:
        self.settings, self.seen = settings, Seen()
        self._rewards_from = rewards_from
        self._episodes = settings.episodes is None
        self._rewards = settings.reward_frames is None or rewards_from is None
        self._returns = np.zeros(robots)

    def judge(self, batch: TensorDictBase, frames: int) -> str | None:
        """Count a batch, and say in which way the training fails, if it does.

        Args:
            batch: Collected steps, batch size ``[robots, steps]``.
            frames: Frames collected so far, this batch included.

        Returns:
            ``"diverged"``, ``"short"``, ``"equal"`` (rewards) or ``None``.
        """
        if self._episodes and self._rewards:
            return None
        after = batch["next"]
        for step in range(batch.shape[1]):
            self._count(*(_row(after, key, step) for key in ("reward", "done", "terminated", "diverged", "step_count")))
        return self._judge_episodes() or self._judge_rewards(frames)

    def _count(
        self, reward: np.ndarray, done: np.ndarray, terminated: np.ndarray, diverged: np.ndarray, age: np.ndarray
    ) -> None:
        seen = self.seen
        seen.episodes += int(done.sum())
        seen.diverged += int(diverged.sum())
        seen.short += int((terminated & (age <= self.settings.steps)).sum())
        seen.reward_low = min(seen.reward_low, float(reward.min()))
        seen.reward_high = max(seen.reward_high, float(reward.max()))
        self._returns += reward
        if done.any():
            ended = self._returns[done]
            seen.return_low = min(seen.return_low, float(ended.min()))
            seen.return_high = max(seen.return_high, float(ended.max()))
            self._returns[done] = 0.0

    def _judge_episodes(self) -> str | None:
        asked, seen = self.settings, self.seen
        if self._episodes or asked.episodes is None or seen.episodes < asked.episodes:
            return None
        self._episodes = True
        if seen.diverged >= asked.share * seen.episodes:
            return DIVERGED
        return SHORT if seen.short >= asked.share * seen.episodes else None

    def _judge_rewards(self, frames: int) -> str | None:
        seen, begin = self.seen, self._rewards_from
        if self._rewards or begin is None:
            return None
        if seen.reward_low != seen.reward_high:
            self._rewards = True
            return None
        if frames < begin:
            return None
        # Equal rewards other than 0 add up to a return that tells how long an episode was.
        if seen.reward_low == 0.0:
            self._rewards = True
            return EQUAL
        if seen.episodes >= (self.settings.episodes or 1):
            self._rewards = True
            return EQUAL if seen.return_low == seen.return_high else None
        return None

    def state_dict(self) -> dict[str, Any]:
        """Return the counts and verdicts so far."""
        judged = {"episodes": self._episodes, "rewards": self._rewards}
        return {"seen": asdict(self.seen), "judged": judged, "returns": self._returns.copy()}

    def load_state_dict(self, state: Mapping[str, Any] | None) -> None:
        """Restore what :meth:`state_dict` returned; ``None``, of an older version, counts as judged."""
        if state is None:
            self._episodes = self._rewards = True
            return
        self.seen = Seen(**state["seen"])
        self._returns = np.array(state["returns"])
        # What the settings leave out now stays out.
        self._episodes |= state["judged"]["episodes"]
        self._rewards |= state["judged"]["rewards"]


def _row(after: TensorDictBase, key: str, step: int) -> np.ndarray:
    values: Tensor = after[key]
    return values[:, step, 0].cpu().numpy()
