"""Collect and learn in turns in one process, with a state that can be saved.

The collector works as :class:`torchrl.collectors.Collector` with ``reset_at_each_iter=False``, which does not give out
the state that it holds between two batches; without that state a run cannot be continued exactly.
"""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs import EnvBase

from gctd3.data.finite import check_finite
from gctd3.envs.checkpointing import env_state, load_env_state


class InlineCollector:
    """Step an environment with a policy, a few steps at a time.

    Args:
        env: Environment of batch size ``[N]``; it resets its robots one by one.
        policy: Policy that writes ``"action"``.
        steps: ``T``, control steps in a batch.
    """

    def __init__(self, env: EnvBase, policy: TensorDictModuleBase, steps: int) -> None:
        self.env, self.policy, self.steps = env, policy, steps
        self._state: TensorDictBase = env.reset()
        self.latest: TensorDictBase = self._state  # last input, kept in case collecting fails

    def collect(self) -> TensorDictBase:
        """Collect the next steps, batch size ``[N, T]``.

        Raises:
            NumericalError: If the policy's observation or its action is not finite.
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
        # A single step needs no stack, which would copy it.
        return taken[0].unsqueeze(-1) if self.steps == 1 else torch.stack(taken, dim=-1)

    def follow(self, policy: TensorDictModuleBase) -> None:
        """Continue with another policy, from the robots' current states."""
        self.policy = policy

    def begin_anew(self, collected: TensorDictBase, robots: Tensor) -> None:
        """Let robots begin a new episode; the last steps of those that were going on count as truncated.

        Args:
            collected: The batch of the last steps, batch size ``[N, T]``, which changes.
            robots: The robots, bool ``[N]``.
        """
        for key in ("truncated", "done"):
            collected["next", key][robots, -1] = True
        self._state = self.env.reset(self._state.set("_reset", robots[:, None]))

    def close(self) -> None:
        """Close the environment."""
        self.env.close(raise_if_closed=False)

    def state_dict(self) -> dict[str, Any]:
        """Return the state of the environment and the policy's next observation."""
        return {"state": self._state.to_dict(), "env": env_state(self.env)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state that :meth:`state_dict` returned."""
        self._state = TensorDict(state["state"], self.env.batch_size)
        load_env_state(self.env, state["env"])
