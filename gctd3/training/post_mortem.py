"""Save the data that are needed to find out why numbers of a training are not finite."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tensordict import TensorDictBase

from gctd3.errors import NumericalError
from gctd3.files import new_directory, save_tree, write_manifest
from gctd3.training.checkpoint import STATE
from gctd3.training.progress import Counters

POST_MORTEM = "post_mortem"


def post_mortem(
    directory: Path,
    error: NumericalError,
    counters: Counters,
    seen: Mapping[str, TensorDictBase],
    state: Mapping[str, Any],
) -> NumericalError:
    """Save the last batches and the state of a training, and return the error that says where they are.

    Args:
        directory: Directory of the training.
        error: What was found.
        counters: How far the training had got.
        seen: The last batches, by name.
        state: State of the training.
    """
    target = directory / POST_MORTEM
    message = f"After {counters.frames:,} frames and {counters.updates:,} updates, {error}."
    if target.exists():
        return NumericalError(f"{message} {target} already holds the data of an earlier failure.")
    with new_directory(target) as aside:
        for name, batch in seen.items():
            save_tree(aside / f"{name}.safetensors", batch.to_dict())
        save_tree(aside / STATE, dict(state))
        write_manifest(aside, {"error": message})
    advice = "try a lower algo.learning_rate" if counters.updates else "look for it in the terms of the task"
    return NumericalError(
        f"{message} The last batch and the whole state are in {target} (gctd3.files.load_tree reads them). "
        f"The newest checkpoint is of an earlier moment; {advice}."
    )
