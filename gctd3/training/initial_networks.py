"""Networks of another run from which a training begins."""

from __future__ import annotations

from pathlib import Path

from gctd3.algorithms.base import Algorithm
from gctd3.errors import RunError
from gctd3.training.checkpoint import Checkpoints, fit


def begin_from(algorithm: Algorithm, run: Path) -> int:
    """Copy the networks of a run's newest checkpoint, target networks included; optimisers begin anew.

    Weights that all joints share fit a robot with other joints, too; weights of single joints do not.

    Args:
        algorithm: The algorithm under training.
        run: Directory of the other run.

    Returns:
        The number of frames on which they were trained.

    Raises:
        RunError: If there is no whole checkpoint, or its networks have other names or sizes.
    """
    if not run.is_dir():
        raise RunError(f"init={run}: there is no such directory; a run's directory is expected.")
    newest = Checkpoints(run).newest()
    if newest is None:
        raise RunError(f"init={run}: it has no checkpoint to begin from.")
    state, _ = newest
    given, own = state["algorithm"]["loss"], algorithm.loss.state_dict()
    for name, values in own.items():
        if name not in given:
            raise RunError(f"init={run}: its networks have no {name}; the algorithm and the network must be the same.")
        shape = getattr(given[name], "shape", None)
        if shape != getattr(values, "shape", None):
            raise RunError(
                f"init={run}: its {name} has shape {list(shape or [])}, this training's {list(values.shape)}. The "
                "network's sizes and what a node observes must be the same, and the joints unless they share weights."
            )
    fit(run, lambda: algorithm.loss.load_state_dict(given))
    return int(state["counters"]["frames"])
