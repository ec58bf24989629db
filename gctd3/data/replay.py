"""Replay of n-step transitions, with mirrored copies in the sampled batches."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs.transforms import MultiStepTransform

from gctd3.compat import set_waiting_steps, waiting_steps
from gctd3.data.frame_buffer import FrameBuffer
from gctd3.data.mirror_augmentation import MirrorAugmentation
from gctd3.data.settings import ReplaySettings

KEPT = ("nodes", "counters", "action", ("next", "nodes"), ("next", "counters"), ("next", "reward"))
ENDS = (("next", "done"), ("next", "terminated"), ("next", "truncated"))


class Replay:
    """Store the transitions that a collector delivers, and sample batches for updates.

    Args:
        settings: Sizes and options.
        gamma: Discount of the n-step sums.
        history: Frames in an observation.
        mirror: Reflection of batches, if ``settings.mirror``.
        device: Device of the transitions and of the batches.
    """

    def __init__(
        self,
        settings: ReplaySettings,
        gamma: float,
        history: int = 5,
        mirror: MirrorAugmentation | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        self.settings, self.mirror = settings, mirror if mirror is None else mirror.to(device)
        self.buffer: FrameBuffer | StackedBuffer
        if settings.storage == "frames":
            self.buffer = FrameBuffer(
                settings.buffer_size, settings.batch_size, history, settings.n_step, gamma, device
            )
        else:
            self.buffer = StackedBuffer(settings.buffer_size, settings.batch_size, settings.n_step, gamma, device)

    def __len__(self) -> int:
        return len(self.buffer)

    @property
    def ready(self) -> bool:
        """Return whether a batch's worth of transitions can be drawn."""
        return self.buffer.ready * max(1, self.buffer.robots) >= self.settings.batch_size

    def extend(self, collected: TensorDictBase) -> None:
        """Store ``collected``, batch size ``[robots, time]``."""
        self.buffer.extend(collected)

    def clear(self) -> None:
        """Remove everything that is stored."""
        self.buffer.clear()

    def load_state_dict(self, state: dict[str, Any], rows: Iterable[tuple[int, dict[str, Tensor]]]) -> None:
        """Restore the state that the buffer's ``state_dict`` returned, and the kept rows of a :class:`.FrameBuffer`."""
        if isinstance(self.buffer, FrameBuffer):
            self.buffer.load_state_dict(state, rows)
        else:
            self.buffer.load_state_dict(state)

    def sample(self) -> TensorDictBase:
        """Sample a batch of ``settings.batch_size`` transitions."""
        batch = self.buffer.sample()
        return batch if self.mirror is None else self.mirror(batch)


class StackedBuffer:
    """Store stacks as they came in TorchRL's replay buffer: simple, and six times the memory of frames.

    Args:
        capacity: Transitions kept.
        batch_size: Transitions drawn at once.
        n_step: Rewards summed before the bootstrap.
        gamma: Discount of these rewards.
        device: Device of the transitions.
    """

    robots = 1

    def __init__(
        self, capacity: int, batch_size: int, n_step: int, gamma: float, device: torch.device | str = "cpu"
    ) -> None:
        storage = LazyTensorStorage(capacity, device=torch.device(device))
        self.torchrl = TensorDictReplayBuffer(storage=storage, batch_size=batch_size)
        # By default the transform keeps the done flags of a window's first step; the update needs those of its last.
        self._steps = MultiStepTransform(n_step, gamma, done_keys=[]) if n_step > 1 else None

    def __len__(self) -> int:
        return len(self.torchrl)

    @property
    def ready(self) -> int:
        """Return the number of transitions that can be drawn."""
        return len(self.torchrl)

    def extend(self, collected: TensorDictBase) -> None:
        """Append ``collected``, batch size ``[robots, time]``."""
        steps = collected.select(*KEPT, *ENDS)
        if self._steps is not None:
            steps = self._steps.inv(steps)
            if steps is None:
                return
            steps = steps.select(*KEPT, *ENDS, "steps_to_next_obs")
        self.torchrl.extend(steps.reshape(-1))

    def sample(self) -> TensorDictBase:
        """Sample a batch uniformly."""
        return self.torchrl.sample()

    def clear(self) -> None:
        """Remove everything that is stored."""
        self.torchrl.empty()
        if self._steps is not None:
            set_waiting_steps(self._steps, None)

    def state_dict(self) -> dict[str, Any]:
        """Return everything that is stored."""
        waiting = waiting_steps(self._steps) if self._steps is not None else None
        return {
            "stored": self.torchrl[:].to_dict() if len(self) else None,
            "writer": dict(self.torchrl.writer.state_dict()),
            "waiting": None if waiting is None else waiting.to_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state that :meth:`state_dict` returned."""
        self.torchrl.empty()
        if state["stored"] is not None:
            stored = TensorDict(state["stored"])
            self.torchrl.extend(stored.auto_batch_size_(1))
        self.torchrl.writer.load_state_dict(state["writer"])
        if self._steps is not None and state["waiting"] is not None:
            set_waiting_steps(self._steps, TensorDict(state["waiting"]).auto_batch_size_(2))
