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
    """Remember the first SIGINT or SIGTERM; the second one ends the process.

    Args:
        file: For one of several processes, the file that stands for a signal which another process hears.

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
        """Return the exit code that a shell reports for a program that the signal ended."""
        return 128 + (self.signal or 0)

    @contextlib.contextmanager
    def listening(self) -> Iterator[None]:
        """Listen for signals inside the context; outside the main thread, or with a file, this does nothing."""
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
