"""Curves of a run: ``progress.csv``, whole at every moment, and a TorchRL logger beside it."""

from __future__ import annotations

import csv
import io
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from torchrl.record.loggers import Logger, get_logger
from torchrl.record.loggers.mlflow import MLFlowLogger

from gctd3.errors import ConfigError, RunError
from gctd3.files import check_regular, quoted, write_text
from gctd3.training.checkpoint import FOLDER
from gctd3.training.stop_when import COLUMNS

if TYPE_CHECKING:
    from PIL import Image

PROGRESS, VIDEOS, CLIP_NAME = "progress.csv", "videos", "evaluation/walk"
PROJECT = "gctd3"  # name of wandb's project and mlflow's experiment


class RunLog:
    """Log rows and scalars of a run; as a context manager, end the logger's run too.

    Args:
        directory: Directory to write to.
        kind: Kind of logger: ``csv``, ``tensorboard``, ``wandb``, ``mlflow`` or ``none``.

    Raises:
        ConfigError: If the logger's package is not installed, or it cannot begin.
    """

    def __init__(self, directory: Path, kind: str) -> None:
        self.directory, self.kind = directory, kind
        self.rows: list[dict[str, Any]] = []
        self._logger = make_logger(kind, directory)

    def __enter__(self) -> RunLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.kind == "wandb" and self._logger is not None:
            self._logger.experiment.finish(exit_code=int(error is not None))
        elif self.kind == "mlflow":
            import mlflow

            mlflow.end_run("FINISHED" if error is None else "FAILED")

    def add_row(self, metrics: Mapping[str, float]) -> None:
        """Append a row to ``progress.csv`` and its values to the logger."""
        self.rows.append({name: metrics[name] for name in COLUMNS if name in metrics})
        self._write()
        scalars = {f"evaluation/{name}": metrics[name] for name in COLUMNS[3:] if name in metrics}
        self.scalars(scalars, metrics["frames"])

    def scalars(self, values: Mapping[str, float], frames: float) -> None:
        """Log scalar values after ``frames`` frames."""
        if self._logger is not None:
            for name, value in values.items():
                self._logger.log_scalar(name, value, step=int(frames))

    def clip(self, frames: Sequence[Image.Image], fps: float, step: int) -> None:
        """Save a film of the policy evaluated at ``step``, and log it if the logger takes films."""
        # Imported late, since most trainings film nothing.
        from gctd3.viz.film import gif, write_animation

        path = self.directory / VIDEOS / f"{step:012d}.mp4"
        path.parent.mkdir(exist_ok=True)
        write_animation(path, iter(frames), fps)
        if self._logger is None:
            return
        # TorchRL's log_video needs moviepy or torchcodec to encode tensors; this video is encoded already.
        if self.kind == "tensorboard":
            from tensorboard.compat.proto.summary_pb2 import Summary

            image = Summary.Image(
                width=frames[0].width, height=frames[0].height, colorspace=3, encoded_image_string=gif(frames, fps)
            )
            summary = Summary(value=[Summary.Value(tag=CLIP_NAME, image=image)])
            self._logger.experiment.file_writer.add_summary(summary, step)
        elif self.kind == "wandb":
            import wandb

            # As TorchRL does with numbers: steps are a metric of their own.
            self._logger.experiment.define_metric(CLIP_NAME, step_metric="evaluation/step")
            self._logger.experiment.log({CLIP_NAME: wandb.Video(str(path), format="mp4"), "evaluation/step": step})
        elif self.kind == "mlflow":
            import mlflow

            mlflow.log_artifact(str(path), VIDEOS)

    def restore(self, rows: list[dict[str, Any]], frames: int) -> None:
        """Restore ``rows``, and drop values later than ``frames`` from progress.csv, csv and TensorBoard."""
        self.rows = list(rows)
        self._write()
        if self.kind == "csv":
            for file in (self.directory / "csv").rglob("*.csv"):
                check_regular(file)
                lines = file.read_text(encoding="utf-8").splitlines(keepends=True)
                kept = [line for line in lines if line.endswith("\n") and _step(line) <= frames]
                write_text(file, "".join(kept))
        elif self.kind == "tensorboard" and self._logger is not None:
            from tensorboard.compat.proto.event_pb2 import Event, SessionLog

            # TensorBoard drops values of later steps from earlier files.
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
    """Make a TorchRL logger that writes below ``directory``; mlflow's writes where ``MLFLOW_TRACKING_URI`` says.

    Raises:
        ConfigError: If its package is not installed, or it cannot begin.
    """
    if kind == "none":
        return None
    try:
        if kind == "wandb":
            about = {"project": PROJECT, "log_env_packages": False}
            return get_logger(kind, logger_name=str(directory), experiment_name=_name(directory), wandb_kwargs=about)
        if kind == "mlflow":
            return _mlflow(directory)
        return get_logger(kind, logger_name=str(directory), experiment_name=kind)
    except (ImportError, ModuleNotFoundError) as error:
        raise ConfigError(f"logger={kind} needs its package: pip install 'gctd3[{kind}]' ({error}).") from error
    except Exception as error:
        if kind not in ("wandb", "mlflow"):
            raise
        # Theirs share no base class: no account, no server.
        reason = str(error).strip() or type(error).__name__
        raise ConfigError(f"logger={kind} cannot begin: {reason.splitlines()[0]}") from error


def _mlflow(directory: Path) -> Logger:
    import mlflow

    # Hide its messages about making a database.
    for name in ("mlflow.store.db.utils", "alembic.runtime.migration"):
        logging.getLogger(name).setLevel(logging.WARNING)
    logger = MLFlowLogger(exp_name=PROJECT, tracking_uri=mlflow.get_tracking_uri())
    mlflow.set_tag("mlflow.runName", _name(directory))
    return logger


def _name(directory: Path) -> str:
    """Return the name of a run among others."""
    here = Path.cwd()
    return str(directory.relative_to(here) if directory.is_relative_to(here) else directory.name)


def refuse_a_run(directory: Path) -> None:
    """Raise a :class:`.RunError` if a training has written to ``directory``."""
    if (directory / PROGRESS).exists() or (directory / FOLDER).exists():
        raise RunError(
            f"{directory} holds a run already: choose another hydra.run.dir, or continue it with "
            f"{quoted(f'resume={directory}')}."
        )
