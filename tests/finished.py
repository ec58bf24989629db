"""Make once per test session what many tests need: a few tiny runs, for those that need no training of their own."""

import contextlib
import io
import os
import random
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from filelock import FileLock
from running import train

# A library's episodes have no falls in so few frames, and an evaluation is as long as they are.
LIBRARY = ["task=walker2d", "env.num_envs=2", "evaluation.episodes=1", "evaluation.every=200", "total_frames=120"]
# Robots on four feet stand until their time is over.
BRIEF = "task.terminations.time_limit.steps=100"
# Robots that try jumps for an episode, and show the fittest ones in a second one.
JUMP = ["task=jump", "env.num_envs=32", "exploration.learning_starts=8960", "replay.buffer_size=20000"]
JUMP += ["total_frames=9088", "evaluation.every=64", "imitation.updates=3"]
# What each run is trained with besides running.TINY, and what of TINY does not apply to it.
RUNS = {
    "gctd3": (["algo=gctd3"], ()),
    "gctd3 seed 1": (["algo=gctd3", "seed=1"], ()),
    "td3": (["algo=td3"], ()),
    "td3 seed 1": (["algo=td3", "seed=1"], ()),
    "ddpg": (["algo=ddpg"], ()),
    "sac": (["algo=sac"], ()),
    "quadruped": (["algo=gctd3", "robot=quadruped", "imitation.updates=3", BRIEF], ()),
    "velocity": (["algo=gctd3", "robot=quadruped", "task=velocity", "imitation.updates=3", BRIEF], ()),
    "jump": (
        ["algo=gctd3", *JUMP],
        ("env.num_envs", "exploration.learning_starts", "replay.buffer_size", "total_frames", "evaluation.every"),
    ),
    "dm_control": (["algo=gctd3", "env.backend=dm_control"], ()),
    "library": (
        ["algo=gctd3", *LIBRARY],
        ("env.num_envs", "env.threads", "evaluation.every", "evaluation.episodes", "total_frames"),
    ),
}


def once(directory, make):
    """Return a folder below ``directory`` that ``make`` has filled when it was first asked for.

    Test processes of one session share the directory: a lock on disk makes the others wait for the first.
    """
    made, whole = directory / "made", directory / "whole"
    directory.mkdir(parents=True, exist_ok=True)
    with FileLock(directory / "lock"):
        if not whole.exists():
            # What failed, or was killed, must not be taken for something finished.
            shutil.rmtree(made, ignore_errors=True)
            made.mkdir()
            with undisturbed():
                make(made)
            whole.touch()
    return made


class Finished:
    """Hold finished runs by the names in ``RUNS``, each trained for the first test that asks for it.

    Args:
        folder: Holds the runs.
    """

    def __init__(self, folder: Path):
        self.folder, self.handed_out = folder, {}

    def __getitem__(self, name):
        """Return the run's directory, only to be read: other tests read it as well."""
        overrides, without = RUNS[name]
        folder = once(self.folder / name.replace(" ", "_"), lambda to: train(to / "run", *overrides, without=without))
        run = folder / "run"
        self.handed_out.setdefault(name, (run, contents(run)))
        return run

    def copy(self, name, to):
        """Copy the run to ``to``, for a test that changes it."""
        return Path(shutil.copytree(self[name], to))

    def check(self):
        """Fail if a run that was handed out has changed."""
        handed_out, self.handed_out = self.handed_out, {}
        for name, (run, before) in handed_out.items():
            if contents(run) != before:
                pytest.fail(f"a test changed the shared run {name!r}: it has to take a copy")


def contents(run):
    """Return size and time of change of every file, by path."""
    found = {}
    for here, _, files in os.walk(run):
        for name in files:
            about = os.stat(os.path.join(here, name))
            found[os.path.join(here, name)] = about.st_size, about.st_mtime_ns
    return found


@contextlib.contextmanager
def undisturbed():
    """Restore random numbers and output: which test trains a run depends on chance."""
    states = random.getstate(), np.random.get_state(), torch.get_rng_state(), torch.get_num_threads()
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            yield
    finally:
        random.setstate(states[0])
        np.random.set_state(states[1])
        torch.set_rng_state(states[2])
        torch.set_num_threads(states[3])
