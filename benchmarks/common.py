"""Functions for all benchmarks: time alternatives side by side, describe the machine, write JSON."""

from __future__ import annotations

import json
import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from gctd3.files import write_text


def options(**defaults: str) -> dict[str, str]:
    """``key=value`` arguments over their defaults; exits with what is accepted if one is unknown."""
    given = dict(argument.split("=", 1) for argument in sys.argv[1:] if "=" in argument)
    unknown = [
        argument for argument in sys.argv[1:] if argument.split("=", 1)[0] not in defaults or "=" not in argument
    ]
    if unknown:
        raise SystemExit(
            f"unknown {', '.join(unknown)}; accepted: {', '.join(f'{k}={v}' for k, v in defaults.items())}"
        )
    return {**defaults, **given}


def rates(work: dict[str, Callable[[], float]], rounds: int) -> dict[str, float]:
    """Median rate of each piece of work, the pieces taken in turn so that a drift of the machine hits all alike.

    Args:
        work: Each call does some work and returns how much.
        rounds: Calls of each, after one that is not counted.
    """
    seen: dict[str, list[float]] = {name: [] for name in work}
    for turn in range(rounds + 1):
        for name, call in work.items():
            began = time.perf_counter()
            done = call()
            if turn:
                seen[name].append(done / (time.perf_counter() - began))
    return {name: statistics.median(values) for name, values in seen.items()}


def commit() -> str:
    """The checkout's, with ``-dirty`` behind it if files differ from it; ``unknown`` outside one."""
    describe = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty"]
    return subprocess.run(describe, capture_output=True, text=True, check=False).stdout.strip() or "unknown"


def machine() -> str:
    """The machine, in words."""
    return f"{os.cpu_count()} CPU cores, {platform.machine()}, Python {platform.python_version()}"


def report(name: str, figures: dict[str, object], out: str) -> None:
    """Print the provenance, and write everything as JSON if ``out`` names a file."""
    # Where files went on this machine is nobody's business.
    arguments = [argument for argument in sys.argv[1:] if "=/" not in argument]
    full = {
        "command": " ".join(["python", f"benchmarks/{name}.py", *arguments]),
        "commit": commit(),
        "machine": machine(),
        **figures,
    }
    print(f"\n{full['command']}  at {full['commit']} on {full['machine']}")
    if out:
        write_text(Path(out), json.dumps(full, indent=1) + "\n")
