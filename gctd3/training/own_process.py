"""A run of a sweep in a process of its own: one that is killed, as for lack of memory, takes no other run with it.

joblib gives up all runs when one of its processes is killed, so those only wait for the processes of the runs.
"""

from __future__ import annotations

import multiprocessing
import signal
import threading
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from hydra import initialize_config_module
from hydra.core.hydra_config import HydraConfig
from hydra.core.utils import setup_globals
from omegaconf import DictConfig, OmegaConf

from gctd3.config.help import CONF
from gctd3.errors import GCTD3Error, RunError

_EXPECTED = (GCTD3Error, OSError, MemoryError)  # errors of which the message says enough


def in_own_process(function: Callable[[Any], Any], config: Any, run: Path, lost: Path) -> Any:  # noqa: ANN401
    """Call a function of Hydra's configuration in a new process, and return what it returns.

    Args:
        function: A function that can be imported by its name.
        config: Its argument.
        run: Directory of the run.
        lost: File to which the new process adds ``run`` if this one is killed, before it ends too.

    Raises:
        RunError: If the new process was killed.
        Exception: What the function raised.
    """
    # joblib's processes have a method of their own, which the new one would look for.
    multiprocessing.set_start_method("spawn", force=True)
    context = multiprocessing.get_context("spawn")
    answers, answer = context.Pipe(duplex=False)
    process = context.Process(target=_call, args=(answer, _hydra(), function, config, str(run), lost))
    process.start()
    # Only the new process has it now: when that ends, nothing more can come.
    answer.close()
    try:
        returned, value = answers.recv()
    except EOFError:
        process.join()
        raise RunError(_ended(process.exitcode or 0)) from None
    process.join()
    if returned:
        return value
    raise value


def _hydra() -> DictConfig:
    """Return Hydra's configuration of this run; the time in the sweep's directory is that of its beginning."""
    config = HydraConfig.instance().cfg
    # Plain, without the classes of plug-ins, which cannot be sent.
    plain: Any = OmegaConf.create(OmegaConf.to_container(config))
    plain.hydra.sweep.dir = str(config.hydra.sweep.dir)
    hydra: DictConfig = plain
    return hydra


def _ended(code: int) -> str:
    if code >= 0:
        return f"Its process ended with exit code {code}."
    name = signal.Signals(-code).name
    perhaps = ", perhaps for lack of memory" if name == "SIGKILL" else ""
    return f"Its process was killed by {name}{perhaps}. It goes on from its last checkpoint."


def _call(
    answer: Connection, hydra: DictConfig, function: Callable[[Any], Any], config: object, run: str, lost: Path
) -> None:
    # The process that began the sweep decides when runs end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, args=(run, lost), daemon=True).start()
    setup_globals()
    HydraConfig.instance().cfg = hydra
    try:
        # A run that goes on composes its first command line again.
        with initialize_config_module(CONF, version_base="1.3"):
            answer.send((True, function(config)))
    except Exception as error:
        if not isinstance(error, _EXPECTED):
            error.add_note(traceback.format_exc())
        try:
            answer.send((False, error))
        except Exception:  # one that cannot be sent
            answer.send((False, RunError(f"It ended with {error!r}.")))


def _end_with_parent(run: str, lost: Path) -> None:
    """End this process once its parent was killed: nobody would hear of the run."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        with lost.open("a", encoding="utf-8") as file:
            file.write(f"{run}\n")
        signal.raise_signal(signal.SIGKILL)
