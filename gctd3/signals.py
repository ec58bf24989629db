"""Handle Ctrl-C, SIGTERM and a hang-up: the first ends a training after its step, and other commands with a line.

A second one ends the process at once.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType

# SIGHUP is what the system sends when the terminal is closed or the connection to it is lost; Windows has none.
_HANGUP = getattr(signal, "SIGHUP", None)
SIGNALS = (signal.SIGINT, signal.SIGTERM, *([] if _HANGUP is None else [_HANGUP]))


def heeded() -> tuple[signal.Signals, ...]:
    """Return the signals to listen for: not a hang-up that is ignored, as ``nohup`` asks for."""
    return tuple(each for each in SIGNALS if each != _HANGUP or signal.getsignal(each) != signal.SIG_IGN)


def leave_at_once(number: int) -> None:
    """End the process as a signal does by itself."""
    signal.signal(number, signal.SIG_DFL)
    os.kill(os.getpid(), number)


class Interruption:
    """Raise ``KeyboardInterrupt`` at the first signal, and remember it; the second one ends the process.

    Attributes:
        signal: The number of the signal, or ``None``.
    """

    def __init__(self) -> None:
        self.signal: int | None = None

    @property
    def exit_code(self) -> int:
        """Return the exit code that a shell reports for a program that the signal ended."""
        return 128 + (self.signal or signal.SIGINT)

    @contextlib.contextmanager
    def listening(self) -> Iterator[None]:
        """Listen for signals inside the context; outside the main thread this does nothing."""
        with _handled_by(self._heard):
            yield

    def _heard(self, number: int, frame: FrameType | None) -> None:
        # Not by resetting the handlers at the first one: Python prints an error if the second has arrived by then.
        if self.signal is not None:
            leave_at_once(number)
        self.signal = number
        raise KeyboardInterrupt


class StopRequest:
    """Remember the first signal; the second one ends the process.

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
        with contextlib.nullcontext() if self.file is not None else _handled_by(self._heard):
            yield

    def _heard(self, number: int, frame: FrameType | None) -> None:
        if self.signal is not None:
            leave_at_once(number)
        self.signal = number
        # The terminal may be gone, and the signal may have come while a line was being written (a RuntimeError).
        with contextlib.suppress(OSError, RuntimeError):
            print("\nFinishing the step to save it; once more leaves at once.", flush=True)


@contextlib.contextmanager
def _handled_by(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Let ``handler`` handle the signals inside the context, where Python lets it: in the main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number in heeded()}
    try:
        yield
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)
