"""Augment batches with mirrored transitions: the reflection of a robot in its sagittal plane, as a transform."""

from __future__ import annotations

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs.transforms import Transform

from gctd3.tasks.reflection import Reflection


class MirrorAugmentation(Transform):
    """Replace the second half of a batch by its reflection in the robot's sagittal plane.

    A robot whose left and right sides are equal learns the same from both: the reflected transition is as valid as
    the observed one.

    Args:
        reflection: Reflection of observations, actions and counters.
        history: Frames stacked in the nodes' features.
    """

    def __init__(self, reflection: Reflection, history: int) -> None:
        super().__init__()
        tables = {
            "nodes": reflection.nodes(reflection.features * history),
            "counters": reflection.counters,
            "actions": reflection.action,
        }
        for name, table in tables.items():
            self.register_buffer(f"{name}_from", torch.from_numpy(table.source))
            self.register_buffer(f"{name}_sign", torch.from_numpy(table.sign.astype(np.float32)))

    def reflect(self, key: str, values: Tensor) -> Tensor:
        """Reflect ``values`` (``nodes [B, N, F]``, ``counters [B, C]`` or ``action [B, A]``) in the sagittal plane."""
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
