"""Progress of what takes longer than a second: a line that is drawn over on a terminal, plain lines elsewhere."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Iterable, Iterator
from types import TracebackType
from typing import TypeVar

FIRST_SECONDS = 1.0  # what is done by then shows nothing
QUIET_SECONDS = 30.0  # from one plain line to the next
_DRAWN_SECONDS = 0.1  # from one drawing of the line on a terminal to the next

T = TypeVar("T")


class StatusLine:
    """Show on stderr what is going on; as a context manager, wipe the line out at the end."""

    def __init__(self) -> None:
        self._terminal = sys.stderr.isatty()
        self._next = time.monotonic() + FIRST_SECONDS
        self._drawn = False

    def __enter__(self) -> StatusLine:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._drawn:
            print("\r\033[K", end="", file=sys.stderr, flush=True)

    def show(self, text: str) -> None:
        """Show a text, unless another was shown just before."""
        now = time.monotonic()
        if now < self._next:
            return
        self._next = now + (_DRAWN_SECONDS if self._terminal else QUIET_SECONDS)
        if self._terminal:
            self._drawn = True
            print(f"\r\033[K{text[: shutil.get_terminal_size().columns - 1]}", end="", file=sys.stderr, flush=True)
        else:
            print(text, file=sys.stderr, flush=True)


def tracked(items: Iterable[T], what: str, total: int) -> Iterator[T]:
    """Iterate over items, and show how many of ``total`` are done: ``drawing pictures: 12 of 48``."""
    with StatusLine() as line:
        for done, item in enumerate(items):
            line.show(f"{what}: {done:,} of {total:,}")
            yield item
