"""Run the commands in a test: tiny trainings, in this process or in one of their own."""

import copy
import csv
import importlib
import subprocess
import sys
import time

import pytest
from hydra._internal.hydra import Hydra

from gctd3.training import trainer as trainer_module
from gctd3.training.trainer import Trainer

# Four robots for 60 steps, the first 20 to warm up.
TINY = {
    "env.num_envs": 4,
    "env.threads": 1,
    "threads": 1,
    "logger": "none",
    "total_frames": 240,
    "exploration.learning_starts": 80,
    "gradient_steps": 2,
    "evaluation.every": 80,
    "evaluation.episodes": 2,
    "replay.batch_size": 16,
    "replay.buffer_size": 1000,
    "network.hidden": "[16,16]",
}


class Recorded(Trainer):
    """Train, and keep a copy of every evaluated policy, by frames."""

    last = None

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.policies = {}
        Recorded.last = self

    def _evaluate(self):
        self.policies[self.counters.frames] = copy.deepcopy(self.algorithm.policy())
        return super()._evaluate()


def command(name, *arguments, trainer=None):
    """Run ``python -m gctd3.NAME ARGUMENTS`` in this process; return its exit code."""
    with pytest.MonkeyPatch.context() as patch:
        # Hydra's logging would close the streams of existing handlers, and absl's handler has pytest's stream.
        quiet = ["hydra/job_logging=none", "hydra/hydra_logging=none"]
        patch.setattr(sys, "argv", [f"gctd3.{name}", *map(str, arguments), *quiet])
        patch.setattr(trainer_module, "Trainer", trainer or Recorded)
        # Hydra would compose everything once more, only to learn whether hydra.mode asks for a sweep, and take any
        # failure for a no. In processes of their own the commands do so.
        patch.setattr(Hydra, "get_mode", lambda *_, **__: None)
        try:
            importlib.import_module(f"gctd3.{name}").main()
        except SystemExit as end:
            return end.code
    return 0


def process(name, *arguments):
    """Run the same in a process of its own."""
    return subprocess.run([sys.executable, "-m", f"gctd3.{name}", *arguments], capture_output=True, text=True)


def tiny(directory, *overrides, without=()):
    return [f"{k}={v}" for k, v in TINY.items() if k not in without] + [f"hydra.run.dir={directory}", *overrides]


def train(directory, *overrides, without=()):
    assert command("train", *tiny(directory, *overrides, without=without)) == 0
    return directory


def rows(run, drop=()):
    with (run / "progress.csv").open(encoding="utf-8") as file:
        return [{k: v for k, v in row.items() if k not in drop} for row in csv.DictReader(file)]


def wait_for(condition, seconds=120):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "nothing happened"
        time.sleep(0.02)
