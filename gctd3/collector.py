"""Collecting beside learning in one process, with a state that can be saved.

As :class:`torchrl.collectors.Collector` with ``reset_at_each_iter=False``, which does not give out the state that it
holds between two batches; without it a run cannot be continued exactly.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from gctd3.envs.state import env_state, load_env_state
from gctd3.errors import ConfigError, check_between
from gctd3.faults import check_finite

MOST_WORKERS = 10_000


@dataclass(frozen=True)
class InlineSettings:
    """Collecting and learning take turns, in one process.

    Attributes:
        chunk: Of every batch of steps, how many are collected at once.
    """

    chunk: ClassVar[int] = 1

    def check_here(self, num_envs: int) -> None:
        """Nothing of this machine matters."""


@dataclass(frozen=True)
class ProcessSettings:
    """Collecting beside learning: processes that step their share of the robots while the learner learns.

    Attributes:
        workers: Processes, among which the robots are divided.
        cpus: Threads of each, for its simulation and its policy.
        chunk: As many times ``steps`` are collected between two messages, and as many times ``updates`` follow.
        patience: Time (s) after which a worker that delivers nothing counts as hung.
        start_within: Time (s) that a worker may take to start.
        failures: Failures of a worker in a row, without a batch in between, that are borne; at one more the run ends.
    """

    workers: int = 2
    cpus: int = 1
    chunk: int = 4
    patience: float = 60.0
    start_within: float = 300.0
    failures: int = 3

    def __post_init__(self) -> None:
        check_between(self, 1, MOST_WORKERS, "workers", "chunk")
        check_between(self, 1, 1024, "cpus")
        check_between(self, 0, 10**6, "failures")
        for name in ("patience", "start_within"):
            value = getattr(self, name)
            if not 0 < value < math.inf:
                raise ConfigError(f"{name} must be above 0 s, got {value}.")

    def check_here(self, num_envs: int) -> None:
        """Raise a :class:`.ConfigError` if there are more workers than robots."""
        if self.workers > num_envs:
            raise ConfigError(
                f"collector.workers must be at most env.num_envs = {num_envs}, got {self.workers}: "
                "every worker steps some of the robots."
            )

    def shares(self, num_envs: int) -> list[slice]:
        """The robots of each worker."""
        bounds = [num_envs * i // self.workers for i in range(self.workers + 1)]
        return [slice(start, stop) for start, stop in itertools.pairwise(bounds)]


class InlineCollector:
    """Steps an environment with a policy, a few steps at a time.

    Args:
        env: Of batch size ``[N]``; it resets its robots one by one.
        policy: Writes ``"action"``.
        steps: ``T``, control steps in a batch.
    """

    def __init__(self, env: EnvBase, policy: TensorDictModuleBase, steps: int) -> None:
        self.env, self.policy, self.steps = env, policy, steps
        self._state: TensorDictBase = env.reset()
        self.latest: TensorDictBase = self._state  # what it was at work on, should that fail

    def collect(self) -> TensorDictBase:
        """The next steps, batch size ``[N, T]``.

        Raises:
            NumericalError: If what the policy sees or its action is not finite.
        """
        taken = []
        with torch.no_grad():
            for _ in range(self.steps):
                self.latest = self._state
                check_finite("nodes", self._state.get("nodes"))
                acting = self.latest = self.policy(self._state)
                check_finite("action", acting.get("action"))
                step, self._state = self.env.step_and_maybe_reset(acting)
                taken.append(step)
        # A copy saved where there is nothing to stack.
        return taken[0].unsqueeze(-1) if self.steps == 1 else torch.stack(taken, dim=-1)

    def follow(self, policy: TensorDictModuleBase) -> None:
        """Go on with another policy, from where the robots are."""
        self.policy = policy

    def close(self) -> None:
        """End the environment."""
        self.env.close(raise_if_closed=False)

    def state_dict(self) -> dict[str, Any]:
        """Where the robots are and what the policy is about to see."""
        return {"state": self._state.to_dict(), "env": env_state(self.env)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore :meth:`state_dict`."""
        self._state = TensorDict(state["state"], self.env.batch_size)
        load_env_state(self.env, state["env"])
