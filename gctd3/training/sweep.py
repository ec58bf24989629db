"""Runs of a sweep on one machine: how they share its cores, how all are stopped together, and how the sweep ends."""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path
from types import FrameType
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf, open_dict

from gctd3.files import quoted
from gctd3.signals import heeded
from gctd3.training.saved_configuration import CONFIG

STOP = ".stop"  # in the sweep's directory while its runs are to end
LOST = ".lost"  # in the sweep's directory: those of the runs whose processes were killed
AGAIN = "GCTD3_SWEEP_WITHOUT"  # environment variable of a sweep that began again: the runs it leaves out
WATCH = 0.5  # between looks for what was lost (s)


def runs_at_once(launcher: DictConfig) -> int:
    """Return how many runs a Hydra launcher has side by side in processes of this machine."""
    jobs = int(launcher.get("n_jobs") or 1)
    return jobs if jobs > 0 else max(1, cores() + 1 + jobs)  # as joblib counts


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def stop_file() -> Path | None:
    """Return the file that asks this run to end, if it is one of several side by side."""
    config = HydraConfig.get()
    beside = config.mode is RunMode.MULTIRUN and runs_at_once(config.launcher) > 1
    return Path(config.sweep.dir) / STOP if beside else None


def share_cores(config: DictConfig) -> None:
    """Give a run its part of the cores, where ``threads`` and ``env.threads`` leave that open."""
    part = max(1, cores() // runs_at_once(HydraConfig.get().launcher))
    for owner in (config, config.env):
        if "threads" in owner and owner.threads is None:
            OmegaConf.update(owner, "threads", part)


def heed_no_interrupts() -> None:
    """Ignore Ctrl-C in a process that executes runs: the process that started it decides when runs end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


class StopTogether(Callback):
    """Let every run save itself at the first Ctrl-C or SIGTERM; a second one ends all at once.

    This Hydra callback listens for runs side by side; one run after another hears signals by itself. Hydra (1.3.8)
    tells no callback of the end of a sweep in which a run failed, and jobs of joblib have copies of it: see
    :func:`end`.
    """

    def __init__(self) -> None:
        self.signal: int | None = None
        self.directory: Path | None = None
        self._before: dict[int, Any] = {}

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:  # noqa: ANN401 - Hydra's
        """Begin to listen for signals."""
        _SWEEPS.append(self)
        self.directory = Path(config.hydra.sweep.dir)
        launcher = config.hydra.launcher
        if runs_at_once(launcher) == 1:
            return
        # joblib calls it in every process that it starts.
        with open_dict(launcher):
            launcher.initializer = {"_target_": "hydra.utils.get_method", "path": f"{__name__}.heed_no_interrupts"}
        (self.directory / STOP).unlink(missing_ok=True)
        if AGAIN not in os.environ:
            (self.directory / LOST).unlink(missing_ok=True)
        self._before = {number: signal.signal(number, self._heard) for number in heeded()}

    def leave(self) -> None:
        """Stop listening for signals."""
        for number, handler in self._before.items():
            signal.signal(number, handler)
        if self.directory is not None:
            (self.directory / STOP).unlink(missing_ok=True)

    def _heard(self, number: int, frame: FrameType | None) -> None:
        if self.signal is not None or self.directory is None:
            raise KeyboardInterrupt
        self.signal = number
        self.directory.mkdir(parents=True, exist_ok=True)
        (self.directory / STOP).touch()
        print("\nFinishing the steps of the runs to save them; once more leaves at once.", flush=True)


_SWEEPS: list[StopTogether] = []  # those of this process, which is the one that began the sweep


def end(error: BaseException | None) -> None:
    """End a sweep, however its runs ended: say how to continue it unless all came to their end.

    If a process of joblib's was killed, with which joblib gives up all others, the sweep begins again without the run
    that it held: the others go on where their checkpoints are.

    Args:
        error: What ended the command; ``None`` if nothing did.

    Raises:
        SystemExit: With 128 and the signal's number if a signal stopped the sweep; with 2 if its processes were lost.
    """
    while _SWEEPS:
        sweep = _SWEEPS.pop()
        sweep.leave()
        directory = sweep.directory
        if directory is None or (error is None and sweep.signal is None):
            continue
        begun = any(directory.rglob(str(CONFIG)))
        broken = type(error).__name__ == "TerminatedWorkerError"  # joblib's, which is not always installed
        if broken and sweep.signal is None and _go_on(directory):
            _begin_again(directory)
        if begun:
            print(f"Continue it with the same command and {quoted(f'hydra.sweep.dir={directory}')}", flush=True)
        if sweep.signal is not None:
            raise SystemExit(128 + sweep.signal)
        if broken:
            raise SystemExit(2)


def _go_on(directory: Path) -> bool:
    """Name the runs whose processes were killed; tell whether there are any that were not named before."""
    known = os.environ.get(AGAIN, "").splitlines()
    until = time.monotonic() + 5 * WATCH
    while not (new := [run for run in lost(directory) if run not in known]) and time.monotonic() < until:
        time.sleep(WATCH / 2)
    for run in new:
        print(f"error: {quoted(run)}: its process was killed; the other runs go on.", file=sys.stderr, flush=True)
    if not new:
        print("error: A process of the sweep was killed, and with it all others.", file=sys.stderr, flush=True)
    os.environ[AGAIN] = "\n".join([*known, *new])
    return bool(new)


def _begin_again(directory: Path) -> None:
    given = any(argument.startswith("hydra.sweep.dir=") for argument in sys.orig_argv)
    sys.stdout.flush()
    os.execv(sys.executable, [*sys.orig_argv, *([] if given else [f"hydra.sweep.dir={directory}"])])


def lost(directory: Path) -> list[str]:
    """Return the directories of the runs of a sweep whose processes were killed."""
    file = directory / LOST
    return file.read_text(encoding="utf-8").splitlines() if file.is_file() else []
