"""Keep a second training out of the directory of a run."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from gctd3.errors import RunError

LOCK = ".lock"


@contextlib.contextmanager
def only_one(run: Path) -> Iterator[None]:
    """Lock the directory of a run; the system releases it when the process ends, however it ends.

    Raises:
        RunError: If another training holds the lock.
    """
    run.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(run / LOCK, timeout=0):
            yield
    except Timeout as error:
        raise RunError(f"Another training writes to {run}: wait for it, or choose another hydra.run.dir.") from error
