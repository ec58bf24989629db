"""A run of a sweep in a process of its own: one that is killed, as for lack of memory, takes no other run with it.

joblib gives up all runs when one of its processes is killed, so those only wait for the processes of the runs.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gctd3.errors import GCTD3Error, RunError

_EXPECTED = (GCTD3Error, OSError, MemoryError)  # errors of which the message says enough


def in_own_process(function: Callable[[Any], Any], config: Any, run: Path, on_orphaned: tuple[Path, float]) -> Any:  # noqa: ANN401 - what the function takes and returns
    """Call a function of Hydra's configuration in a new process, and return what it returns.

    Args:
        function: A function that can be imported by its name.
        config: Its argument.
        run: Directory of the run.
        on_orphaned: File to which the new process adds ``run`` before it ends if this one is killed, and the time
            between looks whether it is (s).

    Raises:
        RunError: If the new process was killed.
        Exception: What the function raised.
    """
    import cloudpickle
    from hydra.core.singleton import Singleton

    with tempfile.TemporaryDirectory(prefix="gctd3-run-") as folder:
        task, outcome = Path(folder) / "task", Path(folder) / "outcome"
        content = (Singleton.get_state(), function, config, str(run), on_orphaned, os.getpid())
        # Where modules are found comes first: the rest may need them.
        task.write_bytes(cloudpickle.dumps((sys.path, cloudpickle.dumps(content))))
        call = [sys.executable, "-m", __name__, str(task), str(outcome)]
        code = subprocess.call(call)
        if outcome.is_file():
            returned, value = cloudpickle.loads(outcome.read_bytes())
            if returned:
                return value
            raise value
    if code < 0:
        name = signal.Signals(-code).name
        perhaps = ", perhaps for lack of memory" if name == "SIGKILL" else ""
        raise RunError(f"Its process was killed by {name}{perhaps}. It goes on from its last checkpoint.")
    raise RunError(f"Its process ended with exit code {code}.")


def _main(task: Path, outcome: Path) -> None:
    import cloudpickle
    from hydra.core.singleton import Singleton
    from hydra.core.utils import setup_globals

    # The process that began the sweep decides when runs end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    setup_globals()
    sys.path[:], content = cloudpickle.loads(task.read_bytes())
    state, function, config, run, on_orphaned, parent = cloudpickle.loads(content)
    threading.Thread(target=_watch, args=(parent, run, *on_orphaned), daemon=True).start()
    Singleton.set_state(state)
    try:
        result = True, function(config)
    except Exception as error:
        if not isinstance(error, _EXPECTED):
            error.add_note(traceback.format_exc())
        result = False, error
    try:
        content = cloudpickle.dumps(result)
    except Exception:
        content = cloudpickle.dumps((False, RunError(f"It ended with {result[1]!r}.")))
    outcome.write_bytes(content)


def _watch(parent: int, run: str, file: Path, every: float) -> None:
    """End this process once its parent was killed: nobody would hear of the run."""
    while os.getppid() == parent:
        time.sleep(every)
    with file.open("a", encoding="utf-8") as lost:
        lost.write(f"{run}\n")
    os._exit(1)


if __name__ == "__main__":
    _main(Path(sys.argv[1]), Path(sys.argv[2]))
