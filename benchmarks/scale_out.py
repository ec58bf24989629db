"""Measure the gain of workers beside the learner, its limit, and what this means for 10, 100 and 1,000 cores.

    python benchmarks/scale_out.py [workers=1,2,4] [seconds=30] [rounds=3] [out=FILE.json]
    python benchmarks/scale_out.py collector=ray seeds=0,1,2 cap=30
    python benchmarks/scale_out.py sizing=FILE.json

For the inline collector and every number of workers it measures the default training: steps/s that are collected while
nobody learns, updates/s while nobody collects, and both while it trains (no evaluations and checkpoints, past the
warm-up). ``seeds`` adds the minutes until it walks: ``python -m gctd3.train`` in a process of its own until an
evaluation is a walk, ``cap`` minutes at most. ``sizing`` only prints the table for other numbers of cores from what was
measured; benchmarks/scale_out.md says how to read it. Nothing else should run on the machine.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from common import options, report
from gait_table import RETURN, passes, read_progress
from hydra import compose, initialize_config_module
from tensordict import TensorDict

from gctd3.config.build import build
from gctd3.training.progress import ProgressLine
from gctd3.training.trainer import Trainer

CORES = (10, 100, 1000)
# No warm-up, evaluation or checkpoint comes in between.
STEADY = ["logger=none", "exploration.learning_starts=0", "evaluation.every=1_000_000_000", "checkpoint_every=1e9"]
STEADY += ["total_frames=1_000_000_000"]
# A training that ends with the first evaluation that gait_table.passes, whatever else it would be asked for.
FIRST_GAIT = ["stop_when.evaluations=1", f"stop_when.at_least.return_mean={RETURN}"]
FIRST_GAIT += ["~stop_when.at_least.velocity_mean", "~stop_when.at_least.stride_hz", "~stop_when.at_most.stride_hz"]
FIRST_GAIT += ["~stop_when.at_most.hip_correlation", "~stop_when.at_most.flight_fraction"]


@dataclass(frozen=True)
class Rates:
    """Hold the measurements of one way to collect.

    Attributes:
        workers: Workers; 0 for the inline collector.
        collected: Env steps/s of all robots while nobody learns.
        learnt: Updates/s while nobody collects.
        steps: Env steps/s while it trains.
        updates: Updates/s while it trains.
        ratio: Updates for each env step.
        batch_frames: Env steps between two messages of all workers.
        weight_bytes: Size of the actor's weights, which every worker gets for every batch.
        step_bytes: Size of one environment step on its way to the learner.
    """

    workers: int
    collected: float
    learnt: float
    steps: float
    updates: float
    ratio: float
    batch_frames: int
    weight_bytes: int
    step_bytes: float

    @property
    def learner_limit(self) -> float:
        """Return the environment steps per second that the learner could take."""
        return self.learnt / self.ratio

    @property
    def limit(self) -> str:
        """Return the side that the other one waits for."""
        return "learner" if self.learner_limit <= self.collected else "workers"


def per_second(work: Callable[[], float], seconds: float) -> float:
    """Measure the rate of ``work``, whose calls return how much they did; the first call does not count."""
    work()
    began, done = time.perf_counter(), 0.0
    while (spent := time.perf_counter() - began) < seconds:
        done += work()
    return done / spent


def arguments(collector: str, workers: int) -> list[str]:
    """Return the overrides of a training's command line."""
    return [f"collector={collector}", f"collector.workers={workers}"] if workers else ["collector=inline"]


def measure(collector: str, workers: int, seconds: float, more: list[str]) -> Rates:
    """Measure the rates of the default training, changed by ``more``."""
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        settings = build(compose("config", [*STEADY, *arguments(collector, workers), *more]))
    settings.check_here()
    with tempfile.TemporaryDirectory() as directory:
        trainer = Trainer(settings, Path(directory))
        line = ProgressLine(settings.total_frames, 0)

        def collect() -> float:
            return float(trainer.collector.collect().numel())

        def train() -> float:
            trainer._iterate(line)
            return settings.batch_frames

        def learn() -> float:
            trainer.algorithm.update(trainer.replay.sample())
            return 1.0

        try:
            while not trainer.replay.ready:
                trainer.replay.extend(trainer.collector.collect())
            collected = per_second(collect, seconds)
            steps = per_second(train, seconds)
            learnt = per_second(learn, seconds)
            step = trainer.collector.collect()
        finally:
            trainer.collector.close()
        weights = TensorDict.from_module(trainer.algorithm.actor).data
        ratio = settings.batch_updates / settings.batch_frames
        return Rates(
            workers=workers,
            collected=collected,
            learnt=learnt,
            steps=steps,
            updates=steps * ratio,
            ratio=ratio,
            batch_frames=settings.batch_frames,
            weight_bytes=sum(weight.nbytes for weight in weights.values(True, True)),
            step_bytes=sum(value.nbytes for value in step.values(True, True)) / step.numel(),
        )


def minutes_to_gait(collector: str, workers: int, seed: int, cap: float, more: list[str]) -> float:
    """Minutes of training until an evaluation is a walk; infinite if none was within the cap."""
    with tempfile.TemporaryDirectory() as directory:
        run = Path(directory) / "run"
        given = [*arguments(collector, workers), f"seed={seed}", f"time_limit={cap}", "logger=none", *FIRST_GAIT, *more]
        subprocess.run([sys.executable, "-m", "gctd3.train", *given, f"hydra.run.dir={run}"], check=True)
        walks = [row["wall_s"] / 60 for row in read_progress(run / "progress.csv") if passes(row)]
        return walks[0] if walks else math.inf


def sizing(measured: list[Rates]) -> list[str]:
    """Lines of a table for other numbers of cores: what workers would collect, and whether the learner keeps up.

    One core is the learner's, each of the others a worker's. A worker is taken to collect as fast as in the measurement
    with the fewest, where each is the likeliest to have a core; messages grow with the number of workers, so that each
    still steps as many robots.
    """
    beside = [rates for rates in measured if rates.workers]
    if not beside:
        raise SystemExit("sizing needs a measurement with workers")
    one = min(beside, key=lambda rates: rates.workers)
    each = one.collected / one.workers
    learnt = max(rates.learnt for rates in measured)
    share = one.batch_frames / one.workers  # env steps in a message of one worker
    lines = [
        f"A worker collects {each:,.0f} steps/s; the learner does {learnt:,.0f} updates/s.",
        f"{'cores':>6} {'collected/s':>12} {'updates/step to keep up':>24} {'weights MB/s':>13} {'steps MB/s':>11}",
    ]
    for cores in CORES:
        workers = cores - 1
        steps = workers * each
        weights = steps / share * one.weight_bytes
        lines.append(
            f"{cores:>6} {steps:>12,.0f} {learnt / steps:>24.4f} {weights / 1e6:>13.1f} "
            f"{steps * one.step_bytes / 1e6:>11.1f}"
        )
    full = learnt / one.ratio / each
    lines.append(
        f"With {one.ratio:.4f} updates a step, as measured, the learner is the limit from {full:.1f} workers on."
    )
    return lines


def main() -> None:
    """Measure, print, write."""
    given = options(
        collector="process", workers="1,2,4", seconds="30", rounds="3", seeds="", cap="30", more="", out="", sizing=""
    )
    if given["sizing"]:
        saved = json.loads(Path(given["sizing"]).read_text(encoding="utf-8"))
        print("\n".join(sizing([Rates(**row) for row in saved["rates"]])))
        return
    torch.set_num_threads(1)
    more, seconds = given["more"].split(), float(given["seconds"])
    counts = [0, *(int(text) for text in given["workers"].split(","))]
    rounds: dict[int, list[Rates]] = {count: [] for count in counts}
    for _ in range(int(given["rounds"])):
        for count in counts:
            rounds[count].append(measure(given["collector"], count, seconds, more))
    # The round whose training was in the middle.
    measured = [sorted(rows, key=lambda rates: rates.steps)[len(rows) // 2] for rows in rounds.values()]
    print(f"\n{'workers':>8}{'collected/s':>13}{'could learn/s':>15}{'trained/s':>11}{'updates/s':>11}  waits for the")
    for rates in measured:
        name = rates.workers or "inline"
        who = rates.limit if rates.workers else "both in turn"
        print(
            f"{name:>8}{rates.collected:>13,.0f}{rates.learner_limit:>15,.0f}{rates.steps:>11,.0f}"
            f"{rates.updates:>11,.0f}  {who}"
        )
    minutes: dict[str, list[float | None]] = {}
    for count in counts if given["seeds"] else []:
        times = [
            minutes_to_gait(given["collector"], count, int(seed), float(given["cap"]), more)
            for seed in given["seeds"].split(",")
        ]
        minutes[str(count or "inline")] = [time if math.isfinite(time) else None for time in times]
        print(f"{count or 'inline':>8} minutes to a gait: {', '.join(f'{time:.1f}' for time in times)}")
    print("\n" + "\n".join(sizing(measured)))
    figures = {"unit": "per second", "rates": [asdict(rates) for rates in measured], "minutes_to_gait": minutes}
    report("scale_out", figures, given["out"])


if __name__ == "__main__":
    main()
