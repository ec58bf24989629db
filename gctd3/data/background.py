"""Run a function in the background, to wait for its result with a time limit."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

T = TypeVar("T")


def in_thread(function: Callable[[], T], stays: bool = False) -> Future[T]:
    """Run a function in a thread that does not keep the program from ending, and return its future.

    Args:
        function: Function without arguments.
        stays: Whether the thread remains when the function has returned. Processes that ask Linux to be told of their
            parent's death (``PR_SET_PDEATHSIG``) end with the thread that began them.
    """
    future: Future[T] = Future()

    def run() -> None:
        try:
            future.set_result(function())
        except BaseException as error:
            future.set_exception(error)
        else:
            if stays:
                threading.Event().wait()

    threading.Thread(target=run, daemon=True).start()
    return future
