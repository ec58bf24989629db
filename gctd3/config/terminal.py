"""Output that a terminal cannot show, or that nobody reads any more, does not end what was being computed."""

from __future__ import annotations

import codecs
import contextlib
import io
import os
import sys
from collections.abc import Iterator
from typing import Any, TextIO

# Characters of the library's own output, for terminals that show ASCII only (LANG=C, PYTHONIOENCODING=ascii).
PLAIN = {"±": "+-", "≥": ">=", "²": "^2", "³": "^3"}
_ERRORS = "gctd3.plain"


def _plain(error: UnicodeError) -> tuple[str, int]:
    """Replace characters that an encoding lacks: by :data:`PLAIN`, or as Python's ``repr`` would write them."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lacking = error.object[error.start : error.end]
    return "".join(PLAIN.get(c) or c.encode("ascii", "backslashreplace").decode() for c in lacking), error.end


codecs.register_error(_ERRORS, _plain)


def prepare_output() -> None:
    """Let standard output and standard error show every text, line by line, and be there even if they were closed.

    A pipe or a file is shown a line as it is written, as a terminal is: so a log can be followed, and a reader who has
    gone is noticed by the line that nobody reads, not when Python writes the rest at its exit and fails with code 120.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # closed by the shell: `>&-`
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115 - until the process ends
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=_ERRORS, line_buffering=True)


class Enduring:
    """Write to a stream until it fails, and nowhere from then on.

    Args:
        stream: The stream.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write a text if the stream still takes it."""
        try:
            return self._stream.write(text)
        except (OSError, ValueError):  # a ValueError if it was closed
            self._forget()
            return len(text)

    def flush(self) -> None:
        """Write what was held back, if the stream still takes it."""
        try:
            self._stream.flush()
        except (OSError, ValueError):
            self._forget()

    def _forget(self) -> None:
        # What the stream still holds back goes nowhere too: at its exit Python would report that it cannot be written.
        with contextlib.suppress(OSError, ValueError):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())
            os.close(nowhere)

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - of the stream
        return getattr(self._stream, name)


@contextlib.contextmanager
def enduring_output() -> Iterator[None]:
    """Go on inside the context if standard output or error cannot be written: ``| head`` has ended, a terminal is gone.

    What was to be shown is lost; what is being computed is not.
    """
    with (
        contextlib.redirect_stdout(Enduring(sys.stdout)),
        contextlib.redirect_stderr(Enduring(sys.stderr)),
    ):
        yield
