"""Minutes until a policy walks: our default training, our TD3 with an MLP, and other libraries' TD3 on the same task.

    python benchmarks/time_to_gait.py seeds=0,1 our_seeds=0,1,2,3,4 jobs=2 threads=1 out=FILE.json
    python benchmarks/time_to_gait.py contenders=gctd3,sb3 cap=20 every=20000

Walking is an evaluation in which each of 5 episodes reaches the finish, with the paper's mean return or more, under
``reward=paper``. Everybody trains for the same reward, is evaluated every ``every`` steps by the same function from the
same starts, and has ``cap`` minutes on the CPU. Each training is a process of its own; the clock runs from its start,
imports and compilation included, until that evaluation has been written down. ``gctd3`` and ``td3`` are
``python -m gctd3.train algo=...``; what the others are, ``benchmarks/peers.py`` says. Runs that do not get there count
as longer than the cap in every median. Nothing else should run on the machine.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

from common import options, report
from gait_table import RETURN, Row, Run, outcome, passes, read_progress, summary, table, words
from peers import EVALUATING, PACKAGES, RECIPE, evaluating, installed, versions

from gctd3.training.run_log import PROGRESS

EPISODES = 5
OURS = ("gctd3", "td3")
POLL = 0.1  # s


def command(contender: str, seed: int, directory: Path, cap: float, every: int, threads: int) -> list[str]:
    """Return the training's command line."""
    if contender in OURS:
        evaluation = [f"evaluation.every={every}", f"evaluation.episodes={EPISODES}"]
        return our_command(directory, threads, f"algo={contender}", f"seed={seed}", *evaluation)
    given = {"peer": contender, "run": directory, "seed": seed, "every": every, "episodes": EPISODES}
    return peer_command(**given, minutes=cap, threads=threads)


def our_command(directory: Path, threads: int, *arguments: str) -> list[str]:
    """Return the command line of a training of ours."""
    cores = [f"threads={threads}", f"env.threads={threads}"]
    return [sys.executable, "-m", "gctd3.train", *arguments, *cores, f"hydra.run.dir={directory}"]


def peer_command(**given: object) -> list[str]:
    """Return the command line of a peer's training."""
    peers = Path(__file__).with_name("peers.py")
    return [sys.executable, str(peers), *(f"{key}={value}" for key, value in given.items())]


def environment(threads: int) -> dict[str, str]:
    """Return the environment variables of a training: equally many cores for every library, and no GPU."""
    count = str(threads)
    limits = {name: count for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NPROC")}
    # NPROC sizes the thread pool of JAX on the CPU; one thread also needs its matrix products told.
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_multi_thread_eigen=false" if threads == 1 else ""
    return {**os.environ, **limits, "JAX_PLATFORMS": "cpu", **({"XLA_FLAGS": flags.strip()} if flags else {})}


def race(
    run: Run,
    line: list[str],
    directory: Path,
    cap: float,
    threads: int,
    stop: threading.Event,
    walks: Callable[[Sequence[Row]], bool] = lambda curve: passes(curve[-1]),
    whole: bool = False,
) -> None:
    """Start a training, watch it until it walks or its time is up, and fill in ``run``.

    Args:
        run: The run.
        line: The training's command line.
        directory: The run's directory, which is made.
        cap: Minutes, not counting evaluations that :data:`EVALUATING` takes out.
        threads: Of the training.
        stop: Ends it.
        walks: Whether evaluations up to now, one at least, show a walk.
        whole: Whether a training that walks is watched until it ends by itself.
    """
    directory.mkdir(parents=True)
    name = f"{run.contender} seed {run.seed}"
    with (directory / "log.txt").open("w") as log:
        began = time.monotonic()
        process = subprocess.Popen(
            line, stdout=log, stderr=subprocess.STDOUT, env=environment(threads), start_new_session=True
        )
        try:
            while not stop.is_set():
                ended = process.poll() is not None
                rows = read_progress(directory / PROGRESS)
                now = time.monotonic() - began
                for row in rows[len(run.curve) :]:
                    run.minutes = (now - row.get(EVALUATING, 0.0)) / 60
                    run.curve.append({**row, "minutes": run.minutes})
                    print(f"[{run.minutes:5.1f} min] {name}: {words(row)}", flush=True)
                    if not whole and walks(run.curve) and run.minutes <= cap:
                        run.outcome = "reached"
                        return
                last = run.curve[-1] if run.curve else {}
                run.minutes = (now - last.get(EVALUATING, 0.0) - evaluating(directory)) / 60
                if run.minutes >= cap:
                    return
                if ended:
                    run.exit_code = process.returncode
                    reached = whole and bool(run.curve) and walks(run.curve)
                    run.outcome = "failed" if process.returncode else "reached" if reached else "ended"
                    return
                stop.wait(POLL)
            run.outcome = "interrupted"
        finally:
            end(process)
            if (directory / RECIPE).exists():
                run.recipe = json.loads((directory / RECIPE).read_text(encoding="utf-8"))
            print(f"[{run.minutes:5.1f} min] {name}: {outcome(run, cap)}", flush=True)


def end(process: subprocess.Popen[bytes]) -> None:
    """Stop a training and what it started."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        if process.poll() is None:
            os.killpg(process.pid, number)
            try:
                process.wait(timeout=10)
            except subprocess.TimeoutExpired:
                continue


def plan(given: dict[str, str]) -> tuple[list[Run], list[str]]:
    """The runs to make, contenders taking turns, and who cannot run.

    Raises:
        SystemExit: If there is no such contender.
    """
    contenders = given["contenders"].split(",")
    unknown = [name for name in contenders if name not in (*OURS, *PACKAGES)]
    if unknown:
        raise SystemExit(f"no contender {', '.join(unknown)}; there are {', '.join((*OURS, *PACKAGES))}")
    missing = [f"{n}: {PACKAGES[n]} is not installed" for n in contenders if n in PACKAGES and not installed(n)]
    seeds = {n: given["our_seeds"] if n == "gctd3" and given["our_seeds"] else given["seeds"] for n in contenders}
    runs = [Run(n, int(seed)) for n in contenders if n in OURS or installed(n) for seed in seeds[n].split(",")]
    turns = {id(run): [other.contender for other in runs[:i]].count(run.contender) for i, run in enumerate(runs)}
    return sorted(runs, key=lambda run: turns[id(run)]), missing


def interrupted(*_: object) -> None:
    """Take a polite kill, or the end of the terminal, as a Ctrl-C."""
    raise KeyboardInterrupt


@contextmanager
def until_interrupted(stop: threading.Event) -> Iterator[None]:
    """Set ``stop`` at a Ctrl-C, a polite kill or an error, and go on after the first two."""
    before = {polite: signal.signal(polite, interrupted) for polite in (signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    except KeyboardInterrupt:
        print("\nInterrupted; what has ended is reported.", flush=True)
        stop.set()
    except BaseException:
        stop.set()
        raise
    finally:
        for polite, handler in before.items():
            signal.signal(polite, handler)


def main() -> None:
    """Race, report."""
    given = options(
        contenders=",".join((*OURS, *PACKAGES)),
        seeds="0",
        our_seeds="",
        every="20000",
        cap="20",
        jobs="1",
        threads="1",
        runs="runs/time_to_gait",
        out="",
    )
    cap, threads = float(given["cap"]), int(given["threads"])
    runs, missing = plan(given)
    where = {id(run): Path(given["runs"]).absolute() / run.contender / f"seed{run.seed}" for run in runs}
    taken = [f"{run.contender}/seed{run.seed}" for run in runs if where[id(run)].exists()]
    if taken:
        raise SystemExit(f"{given['runs']} holds {', '.join(taken)} already: choose another runs=")
    print(f"{len(runs)} runs of at most {cap:g} min, {given['jobs']} at a time, {threads} threads each", flush=True)
    stop, began = threading.Event(), []

    def start(run: Run) -> None:
        if not stop.is_set():
            began.append(run)
            line = command(run.contender, run.seed, where[id(run)], cap, int(given["every"]), threads)
            race(run, line, where[id(run)], cap, threads, stop)

    with ThreadPoolExecutor(int(given["jobs"])) as pool, until_interrupted(stop):
        list(pool.map(start, runs))
    over = [run for run in runs if run in began and run.outcome != "interrupted"]
    if over:
        print(f"\n{table(over, cap)}")
    for line in missing:
        print(f"not measured: {line}")
    names = dict.fromkeys(run.contender for run in over)
    figures = {
        "criterion": {"episodes": EPISODES, "success_rate": 1.0, "return_mean": RETURN, "reward": "paper"},
        "options": {key: given[key] for key in ("every", "cap", "jobs", "threads")},
        "interrupted": stop.is_set(),
        "versions": {name: versions(name) for name in names if name in PACKAGES},
        "summary": {n: asdict(summary([run for run in over if run.contender == n], cap)) for n in names},
        "runs": [asdict(run) for run in over],
        "not_measured": missing,
    }
    report("time_to_gait", figures, given["out"])
    if stop.is_set():
        raise SystemExit(130)


if __name__ == "__main__":
    main()
