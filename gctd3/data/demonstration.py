"""What robots observed and did while they followed a gait, from which a policy without a clock learns it."""

from __future__ import annotations

import math
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from gctd3.data.mirror_augmentation import MirrorAugmentation


class Demonstration:
    """Record observations and actions, and draw batches from them.

    A gait that repeats has, in each part of its stride, another posture and other velocities: a policy that observes
    them needs no clock to act as the gait does.

    Args:
        batch_size: Pairs of an observation and an action in a batch.
        mirror: Reflection of batches, if any.
        device: Device of the batches.
        most: Observations that are recorded at most; the oldest leave first.
    """

    def __init__(
        self,
        batch_size: int,
        mirror: MirrorAugmentation | None = None,
        device: torch.device | str = "cpu",
        most: float = math.inf,
    ) -> None:
        self.batch_size, self.mirror, self.device, self.most = batch_size, mirror, device, most
        self.clear()

    def clear(self) -> None:
        """Remove everything that is recorded."""
        self._recorded: list[tuple[Tensor, Tensor]] = []
        self._kept: dict[str, Tensor] = {}

    def __len__(self) -> int:
        """Return the number of pairs that can be drawn."""
        return len(self._kept.get("action", ()))

    def add(self, collected: TensorDictBase) -> None:
        """Record collected steps, batch size ``[robots, time]``."""
        steps = collected["nodes"], collected["action"]
        self._recorded.append((steps[0].clone(), steps[1].clone()))
        if len(self._recorded) * collected.numel() > self.most:
            self._recorded.pop(0)

    def keep(self, robots: Tensor) -> None:
        """Keep what some robots did, bool ``[robots]``, to draw from, and forget the rest."""
        for place, name in enumerate(("nodes", "action")):
            steps = [step[place][robots].flatten(0, 1) for step in self._recorded]
            if steps:
                self._kept[name] = torch.cat(steps).to(self.device)
        self._recorded = []

    def sample(self) -> TensorDictBase:
        """Draw a batch of ``"nodes"`` ``[B, N, F]`` and ``"action"`` ``[B, A]``."""
        drawn = torch.randint(len(self), (self.batch_size,)).to(self.device)
        batch = TensorDict({name: values[drawn] for name, values in self._kept.items()}, [self.batch_size])
        return batch if self.mirror is None else self.mirror(batch)

    def state_dict(self) -> dict[str, Any]:
        """Return everything that is recorded, and what can be drawn."""
        recorded = [torch.stack(values) for values in zip(*self._recorded, strict=True)]
        return {"recorded": dict(zip(("nodes", "action"), recorded, strict=False)), "kept": dict(self._kept)}

    def load_state_dict(self, state: dict[str, Any] | None) -> None:
        """Restore what :meth:`state_dict` returned; ``None`` for nothing."""
        self.clear()
        if state is not None:
            recorded = state["recorded"]
            if recorded:
                self._recorded = list(zip(recorded["nodes"], recorded["action"], strict=True))
            self._kept = {name: values.to(self.device) for name, values in state["kept"].items()}
