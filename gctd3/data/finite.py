"""Detect NaN and infinite values before training on them; the trainer saves the data for finding the cause."""

from __future__ import annotations

from collections.abc import Mapping

from tensordict import TensorDictBase
from torch import Tensor

from gctd3.errors import NumericalError

WATCHED = ("nodes", "counters", "action", ("next", "nodes"), ("next", "counters"), ("next", "reward"))


def check_finite(name: str, values: Tensor) -> None:
    """Raise a :class:`.NumericalError` if some of ``values``, shape ``[robots, ...]``, are NaN or infinite."""
    finite = values.isfinite()
    if bool(finite.all()):
        return
    where = (~finite).nonzero()[0].tolist()
    value = float(values[tuple(where)])
    robot = f" of robot {where[0]}" if where else ""
    raise NumericalError(f"{name}{robot} is {value} at index {where} of shape {list(values.shape)}")


def check_collected(collected: TensorDictBase) -> None:
    """Raise a :class:`.NumericalError` if an observation, action or reward is NaN or infinite."""
    for key in WATCHED:
        values = collected.get(key, None)
        if values is not None:
            check_finite(key if isinstance(key, str) else ".".join(key), values)


def check_losses(metrics: Mapping[str, Tensor]) -> None:
    """Raise a :class:`.NumericalError` if a loss, or another metric of an update, is NaN or infinite."""
    for name, value in metrics.items():
        check_finite(name, value)
