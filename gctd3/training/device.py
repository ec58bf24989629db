"""Check and choose the device on which tensors are stored and computed."""

from __future__ import annotations

import re
import sys
from typing import TYPE_CHECKING

from gctd3.errors import ConfigError

if TYPE_CHECKING:
    import torch

NAMES = r"cpu|cuda(:\d+)?"


def check_device(name: str) -> None:
    """Raise a :class:`ConfigError` unless ``name`` is ``cpu``, ``cuda`` or ``cuda:0`` and so on."""
    if not re.fullmatch(NAMES, name):
        raise ConfigError(f"device must be cpu, cuda, or cuda:0 and so on, got {name!r}.")


def check_index(name: str) -> None:
    """Raise a :class:`ConfigError` if there are GPUs here but not the one of that name."""
    import torch

    index = int(name.partition(":")[2] or 0)
    if name != "cpu" and torch.cuda.is_available() and index >= torch.cuda.device_count():
        raise ConfigError(f"device={name}: there are {torch.cuda.device_count()} GPUs, counted from cuda:0.")


def pick_device(name: str) -> torch.device:
    """Return the device of that name, or the CPU, after a line on stderr that says why, if there is no GPU.

    Raises:
        ConfigError: If the name is invalid, or there are GPUs but not this one.
    """
    import torch

    check_device(name)
    if name == "cpu":
        return torch.device("cpu")
    if not torch.cuda.is_available():
        build = "this PyTorch is a CPU build" if torch.version.cuda is None else "PyTorch finds no usable GPU or driver"
        print(f"device={name}: {build}; running on the CPU instead.", file=sys.stderr)
        return torch.device("cpu")
    check_index(name)
    return torch.device(name)
