"""Does the default training walk? Trains one algorithm over several seeds and judges each best policy over 50 episodes.

    python benchmarks/walk.py algo=gctd3 seeds=0,1,2,3,4 out=benchmarks/results/walk_gctd3.json

Each seed is a process of ``python -m gctd3.train``; any other key is passed on to it. The JSON holds the command, the
commit, the machine, and for each seed the evaluation, the wall-clock and the learning curve, failures included.
"""

from __future__ import annotations

import csv
import json
import os
import platform
import subprocess
import sys
import time
from pathlib import Path

EPISODES = 50
OWN = {"algo": "gctd3", "seeds": "0,1,2,3,4", "out": "", "runs": "runs/benchmark"}


def main() -> None:
    """Train, evaluate, report."""
    given = dict(argument.split("=", 1) for argument in sys.argv[1:])
    own = {key: given.pop(key, default) for key, default in OWN.items()}
    passed_on = [f"{key}={value}" for key, value in given.items()]
    rows = []
    for seed in (int(text) for text in own["seeds"].split(",")):
        run = Path(own["runs"]) / own["algo"] / f"seed{seed}"
        arguments = [f"algo={own['algo']}", f"seed={seed}", *passed_on]
        began = time.monotonic()
        subprocess.run([sys.executable, "-m", "gctd3.train", *arguments, f"hydra.run.dir={run}"], check=True)
        minutes = (time.monotonic() - began) / 60
        subprocess.run([sys.executable, "-m", "gctd3.evaluate", f"run={run}", f"episodes={EPISODES}"], check=True)
        evaluation = json.loads((run / "evaluation.json").read_text())
        with (run / "progress.csv").open() as stream:
            curve = [{key: float(text) for key, text in row.items() if text} for row in csv.DictReader(stream)]
        rows.append({"seed": seed, "minutes": minutes, "evaluation": evaluation, "curve": curve})
    report = {
        "command": f"python benchmarks/walk.py {' '.join(sys.argv[1:])}",
        "commit": _commit(),
        "machine": f"{os.cpu_count()} CPU cores, {platform.machine()}, Python {platform.python_version()}",
        "algo": own["algo"],
        "passed_on": passed_on,
        "seeds": rows,
    }
    print(table(rows))
    if own["out"]:
        Path(own["out"]).write_text(json.dumps(report, indent=1) + "\n")


def table(rows: list[dict]) -> str:
    """A line for each seed."""
    head = f"{'seed':>4} {'minutes':>8} {'return':>14} {'m/s':>6} {'success':>8} {'hips':>6} {'Hz':>5} {'flight':>7}"
    lines = [head]
    for row in rows:
        e, gait = row["evaluation"], row["evaluation"]["gait"]
        cells = [gait.get(key) for key in ("hip_correlation", "stride_hz", "flight_fraction")]
        hips, hz, flight = (f"{cell:.2f}" if cell is not None else "-" for cell in cells)
        lines.append(
            f"{row['seed']:>4} {row['minutes']:>8.1f} {e['return_mean']:>7.1f} ±{e['return_std']:>5.1f} "
            f"{e['velocity_mean']:>6.2f} {e['success_rate']:>8.2f} {hips:>6} {hz:>5} {flight:>7}"
        )
    return "\n".join(lines)


def _commit() -> str:
    done = subprocess.run(["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=False)
    return done.stdout.strip() or "unknown"


if __name__ == "__main__":
    main()
