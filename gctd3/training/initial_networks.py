"""Networks of another run from which a training begins."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from gctd3.algorithms.base import Algorithm
from gctd3.errors import RunError
from gctd3.setup.setup import Setup
from gctd3.training.checkpoint import Checkpoints, fit
from gctd3.training.saved_configuration import load_settings
from gctd3.training.saved_robot import setup_of
from gctd3.training.wider_inputs import WiderInputs


class Begun(NamedTuple):
    """Tell what networks a training begins from.

    Attributes:
        frames: Number of frames on which they were trained.
        note: A sentence if weights of single joints are those of joints of other names; empty otherwise.
    """

    frames: int
    note: str = ""


def begin_from(algorithm: Algorithm, run: Path, setup: Setup | None = None) -> Begun:
    """Copy the networks of a run's newest checkpoint, target networks included; optimisers begin anew.

    Weights that all joints share fit a robot with other joints, too. Weights of single joints fit robots with as many
    nodes, in the same order. Inputs that this training has beside the run's, such as a height scan, have weights of
    zero.

    Args:
        algorithm: The algorithm under training.
        run: Directory of the other run.
        setup: The setup of this training; ``None`` if its inputs must be the run's.

    Returns:
        What the networks were trained on.

    Raises:
        RunError: If there is no whole checkpoint, its networks have other names or sizes, or they have weights of
            single nodes, whose order is another than here.
    """
    if not run.is_dir():
        raise RunError(f"init={run}: there is no such directory; a run's directory is expected.")
    newest = Checkpoints(run).newest()
    if newest is None:
        raise RunError(f"init={run}: it has no checkpoint to begin from.")
    state, _ = newest
    given, own = dict(state["algorithm"]["loss"]), algorithm.loss.state_dict()
    before = None if setup is None else setup_of(run, load_settings(run))
    inputs: WiderInputs | None = None
    for name, values in own.items():
        if name not in given:
            raise RunError(f"init={run}: its networks have no {name}; the algorithm and the network must be the same.")
        shape = getattr(given[name], "shape", None)
        if shape != getattr(values, "shape", None) and shape is not None and setup is not None and before is not None:
            inputs = inputs or WiderInputs(before, setup)
            wider = inputs.widen(name, given[name], values.shape)
            given[name] = given[name] if wider is None else wider
            shape = given[name].shape
        if shape != getattr(values, "shape", None):
            raise RunError(
                f"init={run}: its {name} has shape {list(shape or [])}, this training's {list(values.shape)}. The "
                "network's sizes and what a node observes must be the same, and the joints unless they share weights."
            )
    note = "" if setup is None or before is None else _compare_nodes(run, before, setup)
    fit(run, lambda: algorithm.loss.load_state_dict(given))
    return Begun(int(state["counters"]["frames"]), note)


def _compare_nodes(run: Path, before: Setup, setup: Setup) -> str:
    """Return a sentence if nodes have the weights of nodes of other names; refuse the same ones in another order."""
    there, here = before.graph.nodes, setup.graph.nodes
    if there == here or setup.architecture().network.shares_joints:
        return ""
    if len(there) != len(here):
        raise RunError(f"init={run}: its graph has {len(there)} nodes, this training's {len(here)}.")
    one, other = next((a, b) for a, b in zip(there, here, strict=True) if a != b)
    if sorted(there) == sorted(here):
        raise RunError(
            f"init={run}: its robot has the same joints in another order, {one} where this one has {other}, and its "
            "network has weights for each. With network.readout=joint, in both trainings, all joints share them."
        )
    return f"Its robot's joints have other names: the weights of {other} are those of {one} there, and so on in order."
