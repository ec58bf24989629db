"""A reward term of one's own: penalise actions that change a lot from one step to the next.

Train with it:

    PYTHONPATH=examples/extending/reward_term python -m gctd3.train \
        --config-dir=examples/extending/reward_term reward=smooth
"""

from __future__ import annotations

from dataclasses import dataclass

from gctd3.tasks.terms import Array, Remembered, RewardTerm, Step


def _keep(before: Array, step: Step) -> Array:
    return step.action


# What the environment keeps from step to step, resets with the episode and writes into checkpoints.
LAST_ACTION = Remembered("last_action", shape=("actions",), start=0.0, update=_keep)


@dataclass(frozen=True)
class ActionRate(RewardTerm):
    """Penalise the squared change of the actions (``action_rate_l2`` of Isaac Lab).

    Attributes:
        weight: Per unit of the squared change; actions are in [-1, 1].
    """

    weight: float = -0.01

    def remembers(self) -> tuple[Remembered, ...]:
        """Return the last action."""
        return (LAST_ACTION,)

    def __call__(self, step: Step) -> Array:
        """Return ``weight`` times the sum over the actions, shape ``[*]``."""
        change = step.action - step.before[LAST_ACTION.name]
        return self.weight * step.xp.sum(change**2, axis=-1)
