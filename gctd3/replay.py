"""Replay: n-step transitions, mirrored copies on the way out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs.transforms import MultiStepTransform, Transform

from gctd3.base import EXTRA
from gctd3.envs.gait import FEATURES
from gctd3.errors import ConfigError
from gctd3.frame_buffer import FrameBuffer
from gctd3.graph import KinematicGraph
from gctd3.nodes import foot_slots
from gctd3.robot import Robot

KEPT = ("nodes", "counters", "action", ("next", "nodes"), ("next", "counters"), ("next", "reward"))
ENDS = (("next", "done"), ("next", "terminated"), ("next", "truncated"))


@dataclass(frozen=True)
class ReplaySettings:
    """What is remembered and how it is drawn.

    Attributes:
        capacity: Transitions kept; the oldest leave first.
        batch_size: Transitions drawn for an update.
        n_step: Rewards summed before the bootstrap (Sutton 1988).
        mirror: Whether half of every batch is reflected in the robot's sagittal plane.
        storage: ``frames`` stores every frame once and stacks at sampling, as :class:`.FrameBuffer` does;
            ``stacked`` stores the stacks as they came, in TorchRL's buffer, at six times the memory.
    """

    capacity: int = 1_000_000
    batch_size: int = 256
    n_step: int = 1
    mirror: bool = False
    storage: Literal["frames", "stacked"] = "frames"

    def __post_init__(self) -> None:
        for name in ("capacity", "batch_size", "n_step"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} must be at least 1, got {getattr(self, name)}.")
        if self.batch_size > self.capacity:
            raise ConfigError(f"batch_size must be at most capacity, got {self.batch_size} and {self.capacity}.")


class Mirror(Transform):
    """Replaces the second half of a batch by its reflection in the robot's sagittal plane.

    A robot whose left and right sides are equal learns the same from both: the reflected transition is as true as
    the one that was seen.

    Args:
        robot: The robot.
        history: Frames stacked in the nodes' features.
    """

    def __init__(self, robot: Robot, history: int) -> None:
        super().__init__()
        graph = KinematicGraph.from_robot(robot)
        width = FEATURES * history
        source = np.arange(graph.num_nodes * width).reshape(graph.num_nodes, width)[list(graph.mirror)]
        sign = np.ones_like(source, dtype=np.float32)
        for row, (name, kind) in enumerate(zip(graph.nodes, graph.kinds, strict=True)):
            if kind == "base":
                sign[row] = EXTRA[robot.base.extra[row - 1]]
            elif kind == "hinge":
                sign[row] = robot.mirror_sign(name)
        # A ground node's features are one per foot, so they change places too.
        feet, slots = np.array(robot.mirror_feet), foot_slots(robot)
        frames = source.reshape(graph.num_nodes, history, FEATURES)
        before = frames.copy()
        for (node, feature), (other_node, other_feature) in zip(slots, slots[feet], strict=True):
            frames[node, :, feature] = before[other_node, :, other_feature]
        hips = len(feet) + feet
        actions, action_sign = robot.action_mirror
        self.register_buffer("nodes_from", torch.from_numpy(source.reshape(-1)))
        self.register_buffer("nodes_sign", torch.from_numpy(sign.reshape(-1)))
        self.register_buffer("counters_from", torch.from_numpy(np.concatenate([feet, hips])))
        self.register_buffer("actions_from", torch.from_numpy(actions))
        self.register_buffer("actions_sign", torch.from_numpy(action_sign.astype(np.float32)))
        hip_sign = [robot.mirror_sign(leg[0].name) for leg in robot.legs]
        self.register_buffer("counters_sign", torch.tensor([1.0] * len(feet) + hip_sign))

    def reflect(self, key: str, values: Tensor) -> Tensor:
        """``values`` (``nodes [B, N, F]``, ``counters [B, C]`` or ``action [B, A]``) of the mirrored robot."""
        if key == "nodes":
            flat = values.flatten(-2).index_select(-1, self.nodes_from) * self.nodes_sign
            return flat.reshape(values.shape)
        if key == "counters":
            return values.index_select(-1, self.counters_from) * self.counters_sign
        return values.index_select(-1, self.actions_from) * self.actions_sign

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Reflect the second half of the batch."""
        half = tensordict.shape[0] // 2
        for key in ("nodes", "counters", "action", ("next", "nodes"), ("next", "counters")):
            values = tensordict.get(key, None)
            if values is not None:
                name = key if isinstance(key, str) else key[-1]
                tensordict.set(key, torch.cat([values[:half], self.reflect(name, values[half:])]))
        return tensordict


class Replay:
    """Takes what a collector delivers, gives batches for updates.

    Args:
        settings: Sizes and options.
        gamma: Discount of the n-step sums.
        history: Frames in an observation.
        mirror: The reflection, if ``settings.mirror``.
        device: Where transitions are kept and batches made.
    """

    def __init__(
        self,
        settings: ReplaySettings,
        gamma: float,
        history: int = 5,
        mirror: Mirror | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        self.settings, self.mirror = settings, mirror if mirror is None else mirror.to(device)
        self.buffer: FrameBuffer | StackedBuffer
        if settings.storage == "frames":
            self.buffer = FrameBuffer(settings.capacity, settings.batch_size, history, settings.n_step, gamma, device)
        else:
            self.buffer = StackedBuffer(settings.capacity, settings.batch_size, settings.n_step, gamma, device)

    def __len__(self) -> int:
        return len(self.buffer)

    @property
    def ready(self) -> bool:
        """Whether a batch's worth of transitions can be drawn."""
        return self.buffer.ready * max(1, self.buffer.robots) >= self.settings.batch_size

    def extend(self, collected: TensorDictBase) -> None:
        """Remember ``collected``, batch size ``[robots, time]``."""
        self.buffer.extend(collected)

    def sample(self) -> TensorDictBase:
        """A batch of ``settings.batch_size`` transitions."""
        batch = self.buffer.sample()
        return batch if self.mirror is None else self.mirror(batch)


class StackedBuffer:
    """TorchRL's replay buffer, with the stacks stored as they came: simple, and six times the memory of frames.

    Args:
        capacity: Transitions kept.
        batch_size: Transitions drawn at once.
        n_step: Rewards summed before the bootstrap.
        gamma: Their discount.
        device: Where they are kept.
    """

    robots = 1

    def __init__(
        self, capacity: int, batch_size: int, n_step: int, gamma: float, device: torch.device | str = "cpu"
    ) -> None:
        storage = LazyTensorStorage(capacity, device=torch.device(device))
        self.torchrl = TensorDictReplayBuffer(storage=storage, batch_size=batch_size)
        # By default the transform leaves the ends of a window's first step in place; the update must see its last.
        self._steps = MultiStepTransform(n_step, gamma, done_keys=[]) if n_step > 1 else None

    def __len__(self) -> int:
        return len(self.torchrl)

    @property
    def ready(self) -> int:
        """Transitions that can be drawn."""
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
        """A batch drawn uniformly."""
        return self.torchrl.sample()
