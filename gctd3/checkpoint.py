"""What a run leaves behind: checkpoints that appear whole or not at all, and the policy in them.

TorchRL's checkpoints hold tensors and JSON, so loading one executes nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from tensordict.nn import TensorDictModuleBase
from torchrl.checkpoint import Checkpoint, CheckpointError, CheckpointRotation
from yaml import YAMLError

import gctd3
from gctd3.errors import ConfigError, RunError
from gctd3.settings import build

if TYPE_CHECKING:
    from gctd3.train_settings import TrainSettings

FORMAT = 1  # of a run directory; raised when an older reader would misread a newer one
CONFIG = Path(".hydra") / "config.yaml"
FOLDER = "checkpoints"
SCORE = "score"


class Checkpoints:
    """The checkpoints of a run: the newest few, and the best.

    Args:
        run: The run's directory.
        keep: How many of the newest to keep.
    """

    def __init__(self, run: Path, keep: int = 1) -> None:
        self._rotation = CheckpointRotation(run / FOLDER, keep_last=keep, keep_best=(SCORE, "max"))

    def save(self, frames: int, score: float, metrics: Mapping[str, float], **components: Any) -> Path:  # noqa: ANN401
        """Write a checkpoint.

        Args:
            frames: Frames collected so far; orders the checkpoints.
            score: The largest one's checkpoint is kept.
            metrics: Of its evaluation, to be read without loading it.
            **components: Objects with a ``state_dict``, or values for JSON.
        """
        metadata = {
            "format": FORMAT,
            "gctd3": gctd3.__version__,
            SCORE: score,
            "frames": frames,
            "metrics": {key: value for key, value in metrics.items() if math.isfinite(value)},
        }
        return self._rotation.save(Checkpoint(**components), step=frames, metadata=metadata)

    def best(self) -> Path:
        """The best checkpoint.

        Raises:
            RunError: If there is none.
        """
        path = self._rotation.best()
        if path is None:
            folder = self._rotation.directory
            raise RunError(f"No checkpoint in {folder}: the run was stopped before its first evaluation.")
        return path


def load_settings(run: str | Path) -> TrainSettings:
    """The settings that a run was started with.

    Raises:
        RunError: If ``run`` is not the directory of a run, or one of another version.
    """
    directory = Path(run)
    file = directory / CONFIG
    if not directory.is_dir():
        raise RunError(f"No run directory at {directory}.")
    if not file.is_file():
        raise RunError(f"{directory} is not a run: it has no {CONFIG}. A run is what gctd3.train leaves behind.")
    try:
        config = OmegaConf.load(file)
        if not isinstance(config, DictConfig):
            raise RunError(f"{file} does not hold a mapping.")
        settings: TrainSettings = build(config)
    except (OmegaConfBaseException, YAMLError, ConfigError) as error:
        raise RunError(
            f"{file} cannot be used by gctd3 {gctd3.__version__}; it is damaged or of another version: {error}"
        ) from error
    return settings


def load_into(checkpoint: Path, **components: Any) -> dict[str, Any]:  # noqa: ANN401
    """Restore ``components`` from a checkpoint.

    Returns:
        The checkpoint's metadata.

    Raises:
        RunError: If it is damaged, of another version, or does not fit the components.
    """
    try:
        metadata = Checkpoint.manifest(checkpoint).get("metadata", {})
        if metadata.get("format") != FORMAT:
            raise RunError(
                f"{checkpoint} has format {metadata.get('format')!r}, written by gctd3 {metadata.get('gctd3')!r}; "
                f"this is gctd3 {gctd3.__version__}, which reads format {FORMAT}."
            )
        Checkpoint(**components).load(checkpoint, components=list(components))
    except (CheckpointError, OSError, KeyError, ValueError, RuntimeError) as error:
        if isinstance(error, RunError):
            raise
        raise RunError(f"{checkpoint} cannot be loaded: {error}") from error
    return dict(metadata)


def load_policy(run: str | Path) -> TensorDictModuleBase:
    """The best deterministic policy of a run.

    Args:
        run: The run's directory.

    Returns:
        A module that reads ``"nodes"`` ``[*, N, F]`` and writes ``"action"`` ``[*, A]``.

    Raises:
        RunError: If ``run`` is not a run, has no checkpoint, or is of another version.
    """
    settings = load_settings(run)
    policy = settings.algo.build(settings.architecture()).policy()
    load_into(Checkpoints(Path(run)).best(), policy=policy)
    return policy
