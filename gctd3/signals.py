"""Handle Ctrl-C and SIGTERM: the first one lets the step finish, a second one ends the process at once."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class StopRequest:
    """Remembers the first SIGINT or SIGTERM; the second one ends the process.

    Args:
        file: Of a process among several: what stands for the signal, which another process hears.

    Attributes:
        signal: The number of the signal, or ``None``.
    """

    def __init__(self, file: Path | None = None) -> None:
        self.signal: int | None = None
        self.file = file

    def __bool__(self) -> bool:
        return self.signal is not None or (self.file is not None and self.file.exists())

    @property
    def exit_code(self) -> int:
        """What a shell reports of a program that the signal ended."""
        return 128 + (self.signal or 0)

    @contextlib.contextmanager
    def listening(self) -> Iterator[None]:
        """Listen for signals meanwhile; only the main thread can, elsewhere or with a file this does nothing."""
        if self.file is not None or threading.current_thread() is not threading.main_thread():
            yield
            return
        before = {number: signal.signal(number, self._heard) for number in SIGNALS}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def _heard(self, number: int, frame: FrameType | None) -> None:
        self.signal = number
        for each in SIGNALS:
            signal.signal(each, signal.SIG_DFL)
        print("\nFinishing the step to save it; once more leaves at once.", flush=True)
