"""Runs of a sweep side by side on one machine: how they share its cores, and how they are all stopped together."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from types import FrameType
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf, open_dict

from gctd3.files import shown
from gctd3.signals import heeded

STOP = ".stop"  # in the sweep's directory while its runs are to end


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

    This Hydra callback is for runs side by side; one run after another hears signals by itself.
    """

    def __init__(self) -> None:
        self.signal: int | None = None
        self._file: Path | None = None
        self._before: dict[int, Any] = {}

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:  # noqa: ANN401 - Hydra's
        """Begin to listen for signals."""
        launcher = config.hydra.launcher
        if runs_at_once(launcher) == 1:
            return
        # joblib calls it in every process that it starts.
        with open_dict(launcher):
            launcher.initializer = {"_target_": "hydra.utils.get_method", "path": f"{__name__}.heed_no_interrupts"}
        self._file = Path(config.hydra.sweep.dir) / STOP
        self._file.unlink(missing_ok=True)
        self._before = {number: signal.signal(number, self._heard) for number in heeded()}

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:  # noqa: ANN401 - Hydra's
        """Stop listening for signals, and say how to continue if the sweep was stopped."""
        if self._file is None:
            return
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._file.unlink(missing_ok=True)
        if self.signal is not None:
            print(f"Continue it with the same command and {shown(f'hydra.sweep.dir={config.hydra.sweep.dir}')}")
            raise SystemExit(128 + self.signal)

    def _heard(self, number: int, frame: FrameType | None) -> None:
        if self.signal is not None or self._file is None:
            raise KeyboardInterrupt
        self.signal = number
        self._file.parent.mkdir(parents=True, exist_ok=True)
        self._file.touch()
        print("\nFinishing the steps of the runs to save them; once more leaves at once.", flush=True)
