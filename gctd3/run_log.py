"""Curves of a run: ``progress.csv``, whole at every moment, and a TorchRL logger beside it."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchrl.record.loggers import Logger, get_logger

from gctd3.checkpoint import FOLDER
from gctd3.errors import ConfigError, RunError
from gctd3.files import write_text
from gctd3.train_settings import COLUMNS

PROGRESS = "progress.csv"


class RunLog:
    """Rows and scalars of a run.

    Args:
        directory: Where to write.
        kind: ``csv``, ``tensorboard``, ``wandb``, ``mlflow`` or ``none``.

    Raises:
        ConfigError: If the logger's package is not installed.
    """

    def __init__(self, directory: Path, kind: str) -> None:
        self.directory, self.kind = directory, kind
        self.rows: list[dict[str, Any]] = []
        self._logger = make_logger(kind, directory)

    def add_row(self, metrics: Mapping[str, float]) -> None:
        """Append a row to ``progress.csv`` and its values to the logger."""
        self.rows.append({name: metrics[name] for name in COLUMNS if name in metrics})
        self._write()
        judged = {f"evaluation/{name}": metrics[name] for name in COLUMNS[3:] if name in metrics}
        self.scalars(judged, metrics["frames"])

    def scalars(self, values: Mapping[str, float], frames: float) -> None:
        """Give values to the logger."""
        if self._logger is not None:
            for name, value in values.items():
                self._logger.log_scalar(name, value, step=int(frames))

    def restore(self, rows: list[dict[str, Any]], frames: int) -> None:
        """Go back to the moment of ``rows``, after ``frames`` frames: what was written later is taken away."""
        self.rows = list(rows)
        self._write()
        if self.kind == "csv":
            for file in (self.directory / "csv").rglob("*.csv"):
                lines = file.read_text(encoding="utf-8").splitlines(keepends=True)
                kept = [line for line in lines if line.endswith("\n") and _step(line) <= frames]
                write_text(file, "".join(kept))
        elif self.kind == "tensorboard" and self._logger is not None:
            from tensorboard.compat.proto.event_pb2 import Event, SessionLog

            # TensorBoard drops what earlier files say of later steps.
            again = Event(step=frames + 1, session_log=SessionLog(status=SessionLog.START))
            self._logger.experiment.file_writer.add_event(again)

    def _write(self) -> None:
        text = io.StringIO()
        writer = csv.DictWriter(text, COLUMNS, restval="")
        writer.writeheader()
        writer.writerows(self.rows)
        write_text(self.directory / PROGRESS, text.getvalue())


def _step(line: str) -> float:
    try:
        return float(line.split(",", 1)[0])
    except ValueError:
        return float("inf")


def make_logger(kind: str, directory: Path) -> Logger | None:
    """A TorchRL logger that writes below ``directory``.

    Raises:
        ConfigError: If its package is not installed.
    """
    if kind == "none":
        return None
    try:
        return get_logger(kind, logger_name=str(directory), experiment_name=kind)
    except (ImportError, ModuleNotFoundError) as error:
        raise ConfigError(f"logger={kind} needs its package: pip install 'gctd3[{kind}]' ({error}).") from error


def refuse_a_run(directory: Path) -> None:
    """Raise a :class:`.RunError` if a training has written to ``directory``."""
    if (directory / PROGRESS).exists() or (directory / FOLDER).exists():
        raise RunError(
            f"{directory} holds a run already: choose another hydra.run.dir, or continue it with resume={directory}."
        )
