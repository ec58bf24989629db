"""Let an actor begin as the warm-up's fittest gait, and tell when another gait is to be looked for."""

from __future__ import annotations

from typing import Any, cast

import torch
from tensordict import TensorDictBase

from gctd3.algorithms.base import Algorithm
from gctd3.algorithms.imitation import Imitation
from gctd3.data.demonstration import Demonstration
from gctd3.data.evolution import Evolution
from gctd3.data.exploration import Explorer
from gctd3.data.gait_policy import ByClock
from gctd3.data.replay import Replay
from gctd3.tasks.simulated_task import SimulatedTask
from gctd3.tasks.task import Task
from gctd3.training.settings import TrainSettings


class GaitImitation:
    """Let the algorithm of a training imitate the fittest gait of the warm-up, if its settings ask for it.

    A policy with a clock imitates the gait at every observation of the replay. One without a clock learns it from what
    robots observe and do while they follow it.

    Args:
        settings: Settings of the training.
        task: Its task.
        replay: Its replay.
        device: Device of the networks.
    """

    def __init__(self, settings: TrainSettings, task: Task, replay: Replay, device: torch.device) -> None:
        self.settings, self.task, self.replay = settings, task, replay
        self.demonstration = Demonstration(settings.replay.batch_size, replay.mirror, device)
        # Networks that begin as another run's have learnt more than a gait.
        self._asked = bool(settings.imitation.updates) and settings.init is None

    def shown_gait(self, explorer: Explorer) -> Evolution | None:
        """Return the gaits of the warm-up, while it lasts, if a policy without a clock is to learn the fittest one."""
        gait, asked = explorer.rhythm, self._asked and self.task.gait is None
        return gait if asked and isinstance(gait, Evolution) and explorer.warming_up else None

    def demonstrates(self, explorer: Explorer) -> bool:
        """Return whether robots follow the fittest gait from the next step on, for a policy without a clock."""
        gait = self.shown_gait(explorer)
        return gait is not None and (gait.shows or gait.decides)

    def begin(self, algorithm: Algorithm, explorer: Explorer) -> float | None:
        """Let the actor act as the fittest gait of the warm-up.

        Returns:
            The mean squared difference of their actions; ``None`` where no gait is imitated.
        """
        if isinstance(explorer.rhythm, Evolution) and explorer.rhythm.final:
            self.demonstration.keep(explorer.rhythm.followers)
        self.follow(algorithm, explorer)
        imitation = algorithm.imitation
        if imitation is None:
            return None
        sample = imitation.sample or self.replay.sample
        difference = imitation.begin(algorithm.actor, sample, self.settings.algo.learning_rate)
        algorithm.average_from_actor()
        return difference

    def follow(self, algorithm: Algorithm, explorer: Explorer) -> None:
        """Let the algorithm's updates imitate the gait, as far as they do; needed again in a resumed training."""
        settings, gait, task = self.settings.imitation, explorer.rhythm, self.task
        if not self._asked:
            return
        if len(self.demonstration):
            algorithm.imitation = Imitation(settings, _demonstrated, self.demonstration.sample)
        elif task.gait is not None and isinstance(gait, Evolution) and gait.tried:
            algorithm.imitation = Imitation(settings, ByClock(gait, cast(SimulatedTask, task)).action)

    def failed(self, algorithm: Algorithm, in_a_row: int, restarts: int) -> bool:
        """Return whether a gait that the actor has not learnt on from failed, and another one is to be looked for.

        Args:
            algorithm: The algorithm.
            in_a_row: Evaluations in a row that met all conditions.
            restarts: Gaits that failed before.
        """
        settings, imitation = self.settings, algorithm.imitation
        if imitation is None or not imitation.critics_alone(algorithm.updates):
            return False
        # A policy that meets the conditions only sometimes counts as none in a row.
        fails = settings.stop_when.evaluations is not None and in_a_row == 0
        return fails and restarts < settings.imitation.retries

    def state_dict(self) -> dict[str, Any]:
        """Return what robots that followed a gait observed and did."""
        return self.demonstration.state_dict()

    def load_state_dict(self, state: dict[str, Any] | None) -> None:
        """Restore what :meth:`state_dict` returned; ``None`` for nothing."""
        self.demonstration.load_state_dict(state)


def _demonstrated(seen: TensorDictBase) -> torch.Tensor:
    action: torch.Tensor = seen["action"]
    return action
