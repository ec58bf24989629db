"""Weights of networks for a task that observes more than the one for which they were trained, such as a height scan.

The inputs that are new have weights of zero, so that networks begin as they were.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from gctd3.setup.setup import Setup


class WiderInputs:
    """Map the inputs of the networks of one setup to those of another, which has all of them and more.

    Args:
        old: The setup of which the weights are.
        new: The setup for which they are to be.
    """

    def __init__(self, old: Setup, new: Setup) -> None:
        self.old, self.new = old.architecture(), new.architecture()
        self.fits = _observes_as_much(old.task, new.task)
        if not self.fits:
            return
        self._features = old.task.features, new.task.features
        self._blocks = new.task.history * new.graph.num_nodes
        known = _counters(new.task)
        self._privileged = [known.index(name) for name in _counters(old.task)] if self.old.privileged_dim else []

    def widen(self, name: str, values: Tensor, shape: torch.Size) -> Tensor | None:
        """Return weights of a shape, with zeros for the new inputs; ``None`` if that is not what makes the difference.

        Args:
            name: Name of the weights.
            values: The weights of the old networks.
            shape: Shape of the new ones.
        """
        if not self.fits or values.ndim != len(shape):
            return None
        axes = [axis for axis, (old, new) in enumerate(zip(values.shape, shape, strict=True)) if old != new]
        if len(axes) != 1:
            return None
        (axis,) = axes
        columns = self._columns(name, values.shape[axis], shape[axis])
        if columns is None:
            return None
        wider = torch.zeros(shape, dtype=values.dtype)
        return wider.index_copy_(axis, columns, values.cpu())

    def _columns(self, name: str, old: int, new: int) -> Tensor | None:
        """Return the new place of each old input of a layer; ``None`` if its inputs are others."""
        before, after = self._features
        if "encoder" in name.split("."):
            blocks = old // before
            return _of_blocks(blocks, before, after) if (blocks * before, blocks * after) == (old, new) else None
        # Actors observe the nodes alone.
        critic = not name.startswith(("actor", "target_actor"))
        privileged = (self.old.privileged_dim, self.new.privileged_dim) if critic else (0, 0)
        kept, made = old - privileged[0], new - privileged[1]
        first = torch.arange(kept)
        if kept != made:
            # Of a network without graph layers: the nodes' features come first, then the action.
            rest = kept - self._blocks * before
            if rest < 0 or made - self._blocks * after != rest:
                return None
            actions = self._blocks * after + torch.arange(rest)
            first = torch.cat([_of_blocks(self._blocks, before, after), actions])
        beside = torch.tensor(self._privileged if critic else [], dtype=torch.int64)
        return torch.cat([first, made + beside])


def _of_blocks(blocks: int, before: int, after: int) -> Tensor:
    return (torch.arange(blocks)[:, None] * after + torch.arange(before)).flatten()


def _observes_as_much(old: Any, new: Any) -> bool:  # noqa: ANN401 - tasks of other libraries have no table
    """Return whether every number that a task observes is at the same place in the other's observation."""
    if not hasattr(old, "table") or not hasattr(new, "table") or old.history != new.history:
        return False
    if old.graph.nodes != new.graph.nodes or old.features > new.features:
        return False
    pairs = zip(old.table.readings, new.table.readings, strict=True)
    same = all(a is None or (b is not None and a.name == b.name) for x, y in pairs for a, b in zip(x, y, strict=False))
    return same and set(_counters(old)) <= set(_counters(new))


def _counters(task: Any) -> list[str]:  # noqa: ANN401
    """Name the numbers that only critics observe: the clocks of terminations, and readings."""
    rows = task.privileged.readings if task.privileged is not None else []
    readings = [one.name for row in rows for one in row if one is not None]
    return [f"clock {i}" for i in range(task.num_counters - len(readings))] + readings
