"""Every step of an environment checked against its specs, to find where a fault begins."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.data import TensorSpec
from torchrl.envs import Transform

from gctd3.errors import NumericalError


class CheckStep(Transform):
    """Check that observations, actions, rewards and done flags are finite and match their specs.

    Values must have the shape and type of their spec and lie in it; none is changed. Append it last, to check the
    policy's own inputs. Steps are counted over all episodes.

    Raises:
        NumericalError: If a value fails a check; the message names the key, the step and, for a number, the robot.
    """

    def __init__(self) -> None:
        super().__init__(in_keys=[], out_keys=[])
        self._steps = 0

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        self._steps += 1
        self._check(tensordict, self.container.full_action_spec, complete=True)
        return tensordict

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        env = self.container
        for spec in (env.full_observation_spec, env.full_reward_spec, env.full_done_spec):
            self._check(next_tensordict, spec, complete=True)
        return next_tensordict

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        self._check(tensordict_reset, self.container.full_observation_spec, complete=False)
        return tensordict_reset

    def _check(self, values: TensorDictBase, specs: Any, complete: bool) -> None:  # noqa: ANN401 - a Composite
        leaves: Iterable[tuple[Any, TensorSpec]] = specs.items(True, True)
        for key, spec in leaves:
            value = values.get(key, None)
            if value is not None:
                self._check_one(key if isinstance(key, str) else ".".join(key), value, spec)
            elif complete:
                raise NumericalError(f"{key} is missing in step {self._steps}")

    def _check_one(self, key: str, value: torch.Tensor, spec: TensorSpec) -> None:
        if value.shape != spec.shape or value.dtype != spec.dtype:
            raise NumericalError(
                f"{key} in step {self._steps} must be {list(spec.shape)} {spec.dtype} as its spec says, "
                f"got {list(value.shape)} {value.dtype}"
            )
        finite = value.isfinite()
        if not bool(finite.all()):
            where = (~finite).nonzero()[0].tolist()
            raise NumericalError(f"{key} of robot {where[0]} is {float(value[tuple(where)])} in step {self._steps}")
        if not spec.is_in(value):
            space = spec.space
            outside = torch.ones_like(finite)
            if hasattr(space, "low"):
                outside = (value < space.low) | (value > space.high)
            where = outside.nonzero()[0].tolist()
            raise NumericalError(
                f"{key} of robot {where[0]} is {float(value[tuple(where)]):g} in step {self._steps}, outside {space}"
            )
