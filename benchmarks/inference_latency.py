"""Time from a state to an action on one core: PyTorch, PyTorch compiled, onnxruntime, and a whole step on a robot.

    python benchmarks/inference_latency.py [out=FILE.json] [run=DIR] [calls=20000] [rounds=10]

One state at a time, as on a robot; without ``run``, of the policy that ships with gctd3. The ways are taken in turn,
``rounds`` times, and every call is timed on its own. ``gctd3.deploy`` is everything from named readings to desired
joint angles: checks, history, network, limits.
"""

from __future__ import annotations

import math
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from common import options, report
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

import gctd3
from gctd3.deploy.export import Deterministic, export_run
from gctd3.deploy.network import open_session
from gctd3.deploy.policy import Policy
from gctd3.deploy.settings import ExportSettings

WARM_UP = 200  # calls of each way that are not counted
STATES = 256  # that are acted on in turn
BUDGET_MS = 1.0  # what the 99th percentile with onnxruntime is to keep to


def ways(run: str | None, folder: Path) -> tuple[dict[str, Callable[[int], object]], list[str]]:
    """Each way to act on the i-th state, and those that are not to be had here, with the reason."""
    file = folder / "policy.onnx"
    export_run(ExportSettings(run=run, out=str(file), threads=1))
    deployed, session = Policy(file), open_session(file)
    network = deployed.contract.network
    rng = np.random.default_rng(0)
    states = rng.standard_normal((STATES, 1, *network.input_shape), dtype=np.float32)
    tensors, policy = torch.from_numpy(states), gctd3.load_policy(run)
    plain = Deterministic(policy).eval()
    features = deployed.contract.features
    readings = [
        {
            f.reading: float(x > 0) if f.binary else float(np.clip(x, f.low, f.high))
            for f, x in zip(features, row, strict=True)
        }
        for row in rng.standard_normal((STATES, len(features)))
    ]
    period = 1.0 / deployed.contract.control_rate_hz
    found: dict[str, Callable[[int], object]] = {
        "PyTorch, gctd3.load_policy": lambda i: policy(TensorDict({"nodes": tensors[i % STATES]}, [1])),
        "PyTorch": lambda i: plain(tensors[i % STATES]),
        "onnxruntime": lambda i: session.run([network.output], {network.input: states[i % STATES]}),
        "gctd3.deploy": lambda i: deployed.step(readings[i % STATES], i * period),
    }
    missing = []
    compiled = torch.compile(plain)
    try:
        compiled(tensors[0])
        found["PyTorch, compiled"] = lambda i: compiled(tensors[i % STATES])
    except Exception as error:  # whatever a missing compiler leads to
        missing.append(f"PyTorch, compiled: {str(error).splitlines()[0]}")
    return found, missing


def measure(work: dict[str, Callable[[int], object]], calls: int, rounds: int) -> dict[str, list[float]]:
    """Milliseconds of every call, by the name of the work; the pieces are taken in turn."""
    seen: dict[str, list[float]] = {name: [] for name in work}
    count = dict.fromkeys(work, 0)
    for turn in range(rounds + 1):
        for name, call in work.items():
            for _ in range(WARM_UP if turn == 0 else math.ceil(calls / rounds)):
                began = time.perf_counter_ns()
                call(count[name])
                took = time.perf_counter_ns() - began
                count[name] += 1
                if turn:
                    seen[name].append(took / 1e6)
    return seen


def percentiles(times: list[float]) -> dict[str, float]:
    """The median, the 99th percentile and the longest."""
    return {"p50": float(np.percentile(times, 50)), "p99": float(np.percentile(times, 99)), "max": max(times)}


def main() -> None:
    """Measure, print, write."""
    given = options(out="", run="", calls="20000", rounds="10")
    torch.set_num_threads(1)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    with (
        tempfile.TemporaryDirectory() as folder,
        torch.no_grad(),
        set_exploration_type(ExplorationType.DETERMINISTIC),
    ):
        work, missing = ways(given["run"] or None, Path(folder))
        times = measure(work, int(given["calls"]), int(given["rounds"]))
    found = {name: percentiles(values) for name, values in times.items()}
    print(f"{'':30}{'p50 ms':>10}{'p99 ms':>10}{'longest ms':>12}")
    for name, row in found.items():
        print(f"{name:30}{row['p50']:>10.3f}{row['p99']:>10.3f}{row['max']:>12.3f}")
    for line in missing:
        print(f"not measured: {line}")
    kept = found["onnxruntime"]["p99"] <= BUDGET_MS
    print(f"p99 with onnxruntime is {'within' if kept else 'above'} {BUDGET_MS:g} ms")
    figures = {"unit": "milliseconds", "calls": int(given["calls"]), "latency": found, "not_measured": missing}
    report("inference_latency", figures, given["out"])


if __name__ == "__main__":
    main()
