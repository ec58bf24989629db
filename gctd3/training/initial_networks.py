"""Networks of another run from which a training begins."""

from __future__ import annotations

from pathlib import Path

from gctd3.algorithms.base import Algorithm
from gctd3.errors import RunError
from gctd3.setup.setup import Setup
from gctd3.training.checkpoint import Checkpoints, fit
from gctd3.training.saved_configuration import load_settings
from gctd3.training.saved_robot import setup_of
from gctd3.training.wider_inputs import WiderInputs


def begin_from(algorithm: Algorithm, run: Path, setup: Setup | None = None) -> int:
    """Copy the networks of a run's newest checkpoint, target networks included; optimisers begin anew.

    Weights that all joints share fit a robot with other joints, too; weights of single joints do not. Inputs that this
    training has beside the run's, such as a height scan, have weights of zero.

    Args:
        algorithm: The algorithm under training.
        run: Directory of the other run.
        setup: The setup of this training; ``None`` if its inputs must be the run's.

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
    given, own = dict(state["algorithm"]["loss"]), algorithm.loss.state_dict()
    inputs: WiderInputs | None = None
    for name, values in own.items():
        if name not in given:
            raise RunError(f"init={run}: its networks have no {name}; the algorithm and the network must be the same.")
        shape = getattr(given[name], "shape", None)
        if shape != getattr(values, "shape", None) and shape is not None and setup is not None:
            inputs = inputs or WiderInputs(setup_of(run, load_settings(run)), setup)
            wider = inputs.widen(name, given[name], values.shape)
            given[name] = given[name] if wider is None else wider
            shape = given[name].shape
        if shape != getattr(values, "shape", None):
            raise RunError(
                f"init={run}: its {name} has shape {list(shape or [])}, this training's {list(values.shape)}. The "
                "network's sizes and what a node observes must be the same, and the joints unless they share weights."
            )
    fit(run, lambda: algorithm.loss.load_state_dict(given))
    return int(state["counters"]["frames"])
