"""Zeros that take up memory only as they are written to."""

from __future__ import annotations

import math
import mmap

import numpy as np
import torch
from torch import Tensor


def lazy_zeros(shape: tuple[int, ...], dtype: torch.dtype, device: torch.device) -> Tensor:
    """Return zeros that take up a CPU's memory only once they are written to.

    PyTorch writes its zeros at once, and so does NumPy where the allocator hands out memory that was used before. Pages
    of their own are empty whatever the process did until then.
    """
    if device.type != "cpu":
        return torch.zeros(shape, dtype=dtype, device=device)
    kind = torch.zeros((), dtype=dtype).numpy().dtype
    pages = mmap.mmap(-1, max(1, math.prod(shape) * kind.itemsize), access=mmap.ACCESS_COPY)
    return torch.from_numpy(np.frombuffer(pages, kind, math.prod(shape)).reshape(shape))
