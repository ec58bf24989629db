"""Resident memory of a training over its time: does it grow once the replay is full?

    python benchmarks/memory.py [minutes=60] [out=FILE.json] [runs=DIR] [replay.buffer_size=100_000] [threads=1]

Trains with the defaults and any further ``key=value``, without an end, and reads the process's memory every 10 s (from
``/proc``, so on Linux). Growth is that of the medians: the last tenth of the time after the replay is full against the
first tenth of it.
"""

from __future__ import annotations

import os
import signal
import statistics
import subprocess
import sys
import time
from pathlib import Path

from common import report
from gait_table import read_progress

from gctd3.training.run_log import PROGRESS

OWN = {"minutes": "60", "out": "", "runs": "runs/memory"}
ENDLESS = {"stop_when": "never", "total_frames": "1_000_000_000", "replay.buffer_size": "100_000"}
EVERY = 10.0  # s

Sample = tuple[float, int, float]  # minutes, frames at the last evaluation, resident memory (MB)


def resident(pid: int) -> float:
    """Resident memory of a process (MB)."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def watch(line: list[str], run: Path, minutes: float) -> list[Sample]:
    """Run a training for so long, and note its memory.

    Raises:
        SystemExit: If it ends by itself.
    """
    samples: list[Sample] = []
    run.mkdir(parents=True)
    with (run / "log.txt").open("w") as log:
        process = subprocess.Popen(line, stdout=log, stderr=subprocess.STDOUT)
        try:
            began = time.monotonic()
            while (now := (time.monotonic() - began) / 60) < minutes:
                time.sleep(min(EVERY, 60 * minutes / 20))
                if process.poll() is not None:
                    raise SystemExit(f"the training ended with {process.returncode}: see {run / 'log.txt'}")
                rows = read_progress(run / PROGRESS)
                frames = int(rows[-1]["frames"]) if rows else 0
                samples.append((round(now, 2), frames, resident(process.pid)))
                print(f"[{now:5.1f} min] {frames:>11,} steps {samples[-1][2]:8.0f} MB", flush=True)
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait()
    return samples


def growth(samples: list[Sample], capacity: int) -> tuple[float, float]:
    """Median memory (MB) in the first and the last tenth of the time after the replay is full.

    Raises:
        SystemExit: If it was not full for long enough.
    """
    full = [memory for _, frames, memory in samples if frames >= capacity]
    tenth = len(full) // 10
    if not tenth:
        raise SystemExit(f"the replay of {capacity:,} was full in {len(full)} samples, of at least 10: train longer")
    return statistics.median(full[:tenth]), statistics.median(full[-tenth:])


def main() -> None:
    """Train, watch, report."""
    given = dict(argument.split("=", 1) for argument in sys.argv[1:])
    own = {key: given.pop(key, default) for key, default in OWN.items()}
    settings = {**ENDLESS, **given}
    run = Path(own["runs"]).absolute()
    if run.exists():
        raise SystemExit(f"{run} is there already: choose another runs=")
    line = [sys.executable, "-m", "gctd3.train", *(f"{k}={v}" for k, v in settings.items()), f"hydra.run.dir={run}"]
    samples = watch(line, run, float(own["minutes"]))
    first, last = growth(samples, int(settings["replay.buffer_size"]))
    print(f"\nonce the replay is full: {first:.0f} MB, at the end {last:.0f} MB ({last / first - 1:+.1%})")
    figures = {"settings": settings, "samples": samples, "first_mb": first, "last_mb": last, "growth": last / first - 1}
    report("memory", figures, own["out"])


if __name__ == "__main__":
    main()
