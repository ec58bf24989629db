"""Stop a training in a test, and compare two runs in everything that they saved."""

import torch
from running import TINY, Recorded, command, rows, tiny

from gctd3.files import load_tree
from gctd3.training.checkpoint import Checkpoints

TIMED = ("wall_s",)


class StopAfter:
    """Ask a training to stop once it has so many frames."""

    def __init__(self, trainer, frames):
        self.trainer, self.frames = trainer, frames

    def __bool__(self):
        return self.trainer.counters.frames >= self.frames


def stopped(directory, frames, *overrides, without=()):
    """Return a run that was stopped after ``frames``."""

    class Stopped(Recorded):
        def run(self, stop=None):
            return super().run(StopAfter(self, frames))

    assert command("train", *tiny(directory, *overrides, without=without), trainer=Stopped) == 0
    return directory


def final_state(run):
    """Return the whole state in the newest checkpoint, replay rows included."""
    state, parts = Checkpoints(run).newest()
    parts = list(parts)
    # Older parts may begin before the ring does.
    rows = TINY["replay.buffer_size"] // TINY["env.num_envs"]
    state["rows"] = {key: torch.cat([part[key] for _, part in parts])[-rows:] for key in parts[0][1]} if parts else {}
    return state


def assert_equal(first, second, path="state"):
    if isinstance(first, dict):
        assert first.keys() == second.keys(), path
        for key in first:
            if key not in TIMED:
                assert_equal(first[key], second[key], f"{path}.{key}")
    elif isinstance(first, list):
        assert len(first) == len(second), path
        for i, (one, other) in enumerate(zip(first, second, strict=True)):
            assert_equal(one, other, f"{path}[{i}]")
    elif hasattr(first, "shape"):
        assert first.dtype == second.dtype, path
        assert (first == second).all(), path
    else:
        assert first == second or (first != first and second != second), path


def assert_same_run(first, second):
    assert rows(first, drop=TIMED) == rows(second, drop=TIMED)
    assert_equal(final_state(first), final_state(second))
    best = [load_tree(Checkpoints(run).best() / "policy.safetensors") for run in (first, second)]
    assert_equal(*best)
