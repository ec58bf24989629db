"""The gait that the warm-up found, as a policy: what an actor imitates, and what is evaluated without one."""

from __future__ import annotations

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from gctd3.data.evolution import Evolution
from gctd3.data.motion_search import MotionSearch
from gctd3.data.stepping import Stepping
from gctd3.data.trials import Shown
from gctd3.tasks.simulated_task import SimulatedTask


class ByClock(TensorDictModuleBase):
    """Act as the fittest gait does at the phase of the observed clock, by the command and the posture that it shows.

    Args:
        gait: Gaits of the warm-up, of which one was tried.
        task: Task whose observations show a clock.
    """

    def __init__(self, gait: MotionSearch, task: SimulatedTask) -> None:
        super().__init__()
        self.in_keys, self.out_keys = ["nodes"], ["action"]
        # Not registered: the gaits belong to the explorer.
        self._of = (gait, task)

    def action(self, seen: TensorDictBase) -> Tensor:
        """Return the actions ``[*, A]`` after observations ``[*]``, on the CPU."""
        gait, task = self._of
        nodes, command = seen["nodes"].to("cpu"), task.shown_command
        posture = task.posture(nodes) if _balances(gait) else None
        return gait.fittest_action(task.phase(nodes), Shown(None if command is None else command(nodes), posture))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the next action of every robot."""
        return tensordict.set("action", self.action(tensordict))


class OpenLoop(TensorDictModuleBase):
    """Act in all robots by a list of actions, whatever they observe, from the start of an episode that all begin.

    Args:
        actions: Action of each control step, shape ``[steps, A]``; the last one is repeated.
    """

    def __init__(self, actions: Tensor) -> None:
        super().__init__()
        self.in_keys, self.out_keys = list[str](), ["action"]
        self.actions, self.taken = actions, 0

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the next action of the list for every robot."""
        action = self.actions[min(self.taken, len(self.actions) - 1)]
        self.taken += 1
        return tensordict.set("action", action.expand(*tensordict.batch_size, -1).clone())


def fittest_gait(gait: MotionSearch, task: SimulatedTask) -> OpenLoop | ByClock | None:
    """Return the fittest gait as a policy for evaluations, ``None`` if none was tried, or none can be replayed.

    Args:
        gait: Gaits of the warm-up.
        task: Their task. Gaits that follow a command or have reflexes are replayed by its clock.
    """
    if isinstance(gait, Evolution) and task.shown_command is None and not _balances(gait):
        return OpenLoop(gait.fittest_actions(task.time_limit)) if gait.tried else None
    return ByClock(gait, task) if gait.tried and task.gait is not None else None


def _balances(gait: MotionSearch) -> bool:
    return isinstance(gait, Stepping) and gait.balances
