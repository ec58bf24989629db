"""Hold an actor to what it begins as: the warm-up's fittest gait, or the policy of another run."""

from __future__ import annotations

import math
from functools import partial
from typing import Any, cast

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs.utils import ExplorationType, set_exploration_type

from gctd3.algorithms.base import Algorithm
from gctd3.algorithms.imitation import Imitation
from gctd3.data.demonstration import Demonstration
from gctd3.data.exploration import Explorer
from gctd3.data.gait_policy import ByClock
from gctd3.data.jumping import Jumping
from gctd3.data.motion_search import MotionSearch
from gctd3.data.replay import Replay
from gctd3.tasks.simulated_task import SimulatedTask
from gctd3.tasks.task import Task
from gctd3.training.evaluations import Evaluations
from gctd3.training.settings import TrainSettings

MOST = 20_000  # observations of robots that try the last gaits: 6 s of 64 robots
SHOWN = 0.5  # share of the batches, before the first update, that are drawn from those that follow the fittest one


class GaitImitation:
    """Let the algorithm of a training imitate the fittest gait of the warm-up, if its settings ask for it.

    A policy with a clock begins as the gait at all that robots observe in the warm-up, half of the time at what those
    observe that follow it, and imitates it at every observation of the replay from then on. One without a clock learns
    it from what robots observe and do while they follow it, and one that jumps at what they observe then. One that
    begins as that of another run is held to that policy, so that critics, which first have to learn what is new, do not
    make it forget to walk.

    Args:
        settings: Settings of the training.
        task: Its task.
        replay: Its replay.
        device: Device of the networks.
    """

    def __init__(self, settings: TrainSettings, task: Task, replay: Replay, device: torch.device) -> None:
        self.settings, self.task, self.replay = settings, task, replay
        known = task.gait is not None and settings.exploration.warmup != "jumping"
        most = MOST if known else math.inf
        self.demonstration = Demonstration(settings.replay.batch_size, replay.mirror, device, most)
        self._asked = bool(settings.imitation.updates)
        self._initial: TensorDictModuleBase | None = None

    def remember(self, algorithm: Algorithm) -> None:
        """Take the policy as it is now, that of another run, as what the actor is held to."""
        self._initial = algorithm.policy() if self._asked else None

    def searched(self, explorer: Explorer) -> MotionSearch | None:
        """Return the gaits of the warm-up, while it lasts, if the actor is to begin as the fittest one."""
        gait = explorer.rhythm
        asked = self._asked and self._initial is None and explorer.warming_up
        return gait if asked and isinstance(gait, MotionSearch) else None

    def demonstrates(self, explorer: Explorer) -> bool:
        """Return whether robots follow the fittest gait from the next step on, for a policy to learn it from them."""
        gait = self.searched(explorer)
        return gait is not None and (gait.shows or gait.decides)

    def anew(self, explorer: Explorer) -> Tensor | None:
        """Return which robots begin a new episode, bool ``[robots]``, because the search for gaits asks for it."""
        exploration = self.settings.exploration_here
        always = exploration.from_standing or exploration.rounds > 1
        return explorer.anew if always or self.searched(explorer) is not None else None

    def ends_warmup(self, explorer: Explorer, evaluations: Evaluations, frames: int) -> bool:
        """End the warm-up after one of its rounds, or let gaits evolve on if the fittest one misses conditions.

        Args:
            explorer: The explorer, whose round is over.
            evaluations: Evaluations of the training.
            frames: Frames so far.

        Returns:
            Whether the warm-up is over.
        """
        gaits = cast(MotionSearch, explorer.rhythm)
        if self._leaves_frames(explorer, frames) and evaluations.gait_misses(gaits, frames):
            gaits.go_on()
            self.demonstration.clear()
            return False
        explorer.end_warmup()
        return True

    def choose(self, explorer: Explorer, evaluations: Evaluations, frames: int) -> None:
        """Choose the gait of the last round that a policy begins as, as after the others, see :meth:`ends_warmup`."""
        gaits = explorer.rhythm
        several = isinstance(gaits, MotionSearch) and gaits.rounds > 1
        if several and self._initial is None and not evaluations.knows_gait:
            evaluations.gait_misses(cast(MotionSearch, gaits), frames)

    def resumes_warmup(self, explorer: Explorer, frames: int) -> int:
        """Let gaits evolve on after a policy that began as one; return for how many frames at most, 0 if none."""
        left = explorer.resume_warmup() if self._leaves_frames(explorer, frames) else 0
        if left:
            self.demonstration.clear()
        return left

    def _leaves_frames(self, explorer: Explorer, frames: int) -> bool:
        """Return whether another round of the warm-up, after so many frames, leaves some to learn in."""
        return frames + explorer.round_frames < self.settings.total_frames

    def _only_shown(self, gait: object) -> bool:
        """Return whether a gait is known only where robots follow it: without a clock, or for a jump."""
        return self.task.gait is None or isinstance(gait, Jumping)

    def begin(self, algorithm: Algorithm, explorer: Explorer) -> float | None:
        """Let the actor act as the fittest gait of the warm-up, unless it began as the policy of another run.

        Returns:
            The mean squared difference of their actions; ``None`` where no gait is imitated.
        """
        if isinstance(explorer.rhythm, MotionSearch) and explorer.rhythm.final:
            self.demonstration.keep(explorer.rhythm.followers)
        self.follow(algorithm, explorer)
        imitation = algorithm.imitation
        if imitation is None or self._initial is not None:
            return None
        sample = imitation.sample or self._everywhere
        difference = imitation.begin(algorithm.actor, sample, self.settings.algo.learning_rate)
        algorithm.average_from_actor()
        if imitation.sample is None:
            # From now on the replay has it.
            self.demonstration.clear()
        return difference

    def _everywhere(self) -> TensorDictBase:
        """Draw a batch from the replay, or as often from what robots observed that followed the gait.

        These are few among all that tried some gait, and what the policy will observe is like theirs.
        """
        shown = len(self.demonstration) and float(torch.rand(())) < SHOWN
        return self.demonstration.sample() if shown else self.replay.sample()

    def follow(self, algorithm: Algorithm, explorer: Explorer) -> None:
        """Let the algorithm's updates imitate the gait or policy; needed again in a resumed training."""
        settings, gait, task = self.settings.imitation, explorer.rhythm, self.task
        if not self._asked:
            return
        if self._initial is not None:
            algorithm.imitation = Imitation(settings, partial(_action, self._initial))
            return
        sample = self.demonstration.sample if self._only_shown(gait) and len(self.demonstration) else None
        if task.gait is not None and isinstance(gait, MotionSearch) and gait.tried:
            # What the gait does at the observed time, without the noise.
            algorithm.imitation = Imitation(settings, ByClock(gait, cast(SimulatedTask, task)).action, sample)
        elif sample is not None:
            algorithm.imitation = Imitation(settings, _demonstrated, sample)

    def failed(self, algorithm: Algorithm, in_a_row: int) -> bool:
        """Return whether a policy that still is the gait, since the actor has not learnt on, misses the conditions.

        Args:
            algorithm: The algorithm.
            in_a_row: Evaluations in a row that met all conditions.
        """
        imitation = algorithm.imitation
        if imitation is None or self._initial is not None or not imitation.critics_alone(algorithm.updates):
            return False
        # A policy that meets the conditions only sometimes counts as none in a row.
        return self.settings.stop_when.evaluations is not None and in_a_row == 0

    def gives_up(self, restarts: int) -> bool:
        """Return whether another gait is looked for after so many that failed."""
        return restarts < self.settings.imitation.retries

    def state_dict(self) -> dict[str, Any]:
        """Return what robots that followed a gait observed and did, and the policy of another run."""
        initial = {} if self._initial is None else {"initial": dict(self._initial.state_dict())}
        return {**self.demonstration.state_dict(), **initial}

    def load_state_dict(self, state: dict[str, Any] | None, algorithm: Algorithm) -> None:
        """Restore what :meth:`state_dict` returned; ``None`` for nothing.

        Args:
            state: The state.
            algorithm: The algorithm, whose policy is of the kind of the other run's.
        """
        self.demonstration.load_state_dict(state)
        if state is not None and "initial" in state:
            self.remember(algorithm)
            if self._initial is not None:
                self._initial.load_state_dict(state["initial"])


@torch.no_grad()
def _action(policy: TensorDictModuleBase, seen: TensorDictBase) -> Tensor:
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        action: Tensor = policy(seen.select(*policy.in_keys).to("cpu"))["action"]
    return action


def _demonstrated(seen: TensorDictBase) -> Tensor:
    action: Tensor = seen["action"]
    return action
