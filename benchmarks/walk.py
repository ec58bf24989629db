"""Test whether the default training walks: train over several seeds, evaluate each best policy over 50 episodes.

    python benchmarks/walk.py algo=gctd3 seeds=0,1,2,3,4 out=benchmarks/results/walk_gctd3.json
    python benchmarks/walk.py algo=td3 jobs=2 threads=1 env.threads=1
    python benchmarks/walk.py robot=quadruped seeds=0,1
    python benchmarks/walk.py task=jump seeds=0,1,2 runs=runs/jump

Each seed is a process of ``python -m gctd3.train``, ``jobs`` of them at a time; any other key is passed on to it. The
JSON holds the command, the commit, the machine, and for each seed the evaluation, the wall-clock and the learning
curve, failures included.
"""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from common import report

EPISODES = 50
OWN = {"algo": "gctd3", "seeds": "0,1,2,3,4", "out": "", "runs": "runs/benchmark", "jobs": "1"}


def train_and_evaluate(algo: str, seed: int, run: Path, passed_on: list[str]) -> dict[str, Any]:
    """One seed, in processes of its own; what they print goes to ``log.txt`` in the run's directory."""
    run.mkdir(parents=True, exist_ok=False)
    with (run / "log.txt").open("w") as log:

        def call(command: str, *arguments: str) -> None:
            module = [sys.executable, "-m", f"gctd3.{command}"]
            subprocess.run([*module, *arguments], check=True, stdout=log, stderr=subprocess.STDOUT)

        began = time.monotonic()
        call("train", f"algo={algo}", f"seed={seed}", *passed_on, f"hydra.run.dir={run}")
        minutes = (time.monotonic() - began) / 60
        call("evaluate", f"run={run}", f"episodes={EPISODES}")
    evaluation = json.loads((run / "evaluation.json").read_text())
    with (run / "progress.csv").open() as stream:
        curve = [{key: float(text) for key, text in row.items() if text} for row in csv.DictReader(stream)]
    return {"seed": seed, "minutes": minutes, "evaluation": evaluation, "curve": curve}


def main() -> None:
    """Train, evaluate, report."""
    given = dict(argument.split("=", 1) for argument in sys.argv[1:])
    own = {key: given.pop(key, default) for key, default in OWN.items()}
    passed_on = [f"{key}={value}" for key, value in given.items()]
    seeds, robot = [int(text) for text in own["seeds"].split(",")], Path(given.get("robot", "biped")).stem
    folder = Path(own["runs"]) / ("" if robot == "biped" else robot) / own["algo"]
    there = [str(folder / f"seed{seed}") for seed in seeds if (folder / f"seed{seed}").exists()]
    if there:
        raise SystemExit(f"there is {', '.join(there)} already: choose another runs=, or move it elsewhere")
    with ThreadPoolExecutor(int(own["jobs"])) as pool:
        rows = list(pool.map(lambda s: train_and_evaluate(own["algo"], s, folder / f"seed{s}", passed_on), seeds))
    print(table(rows))
    report("walk", {"algo": own["algo"], "passed_on": passed_on, "jobs": int(own["jobs"]), "seeds": rows}, own["out"])


def table(rows: list[dict[str, Any]]) -> str:
    """A line for each seed."""
    head = f"{'seed':>4} {'minutes':>8} {'return':>14} {'m/s':>6} {'m':>6} {'success':>8} {'hips':>6} {'Hz':>5}"
    lines = [f"{head} {'flight':>7}"]
    for row in rows:
        e, gait = row["evaluation"], row["evaluation"]["gait"]
        cells = [gait.get(key) for key in ("hip_correlation", "stride_hz", "flight_fraction")]
        hips, hz, flight = (f"{cell:.2f}" if cell is not None else "-" for cell in cells)
        lines.append(
            f"{row['seed']:>4} {row['minutes']:>8.1f} {e['return_mean']:>7.1f} ±{e['return_std']:>5.1f} "
            f"{e['velocity_mean']:>6.2f} {e['distance_mean']:>6.2f} {e['success_rate']:>8.2f} "
            f"{hips:>6} {hz:>5} {flight:>7}"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
