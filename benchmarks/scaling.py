"""Measure how cost grows: environment steps with robots and threads, TD3 updates with nodes, batch and threads.

    python benchmarks/scaling.py [out=FILE.json] [plot=FILE.png] [rounds=5] [threads=1]
    python benchmarks/scaling.py robots=1,8,64 nodes=8,16 batches=256 cores=1,2

An update is a whole one of our TD3 (critics every time, actor and targets every second), on a batch that is there
already. GCN: graph convolutions of 32, 32 and 16 features, then two layers of 256 units; MLP: those two layers alone.
Graphs of other sizes than the biped's are random trees; the propagation matrix is dense, so their shape costs nothing.
``plot`` needs ``pip install 'gctd3[bench]'``.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from common import options, rates, report
from tensordict import TensorDict

import gctd3
from gctd3.algorithms.base import Architecture
from gctd3.algorithms.settings import TD3Settings
from gctd3.envs.factory import build_env
from gctd3.envs.settings import EnvSettings
from gctd3.nn import Network
from gctd3.tasks.walk import WalkingTask
from gctd3.training.sweep import cores

FEATURES, ACTIONS = 10, 6
NODES, BATCH, ROBOTS = 8, 256, (64, 1024)  # where another size grows; the biped has 8 nodes
NETWORKS = {"GCN": Network(norm="none"), "MLP": Network(graph_layers=(), norm="none")}  # the paper's
FRAMES, UPDATES = 2048, 10  # steps of all robots, and updates, that are timed at once

Times = dict[str, dict[int, float]]  # milliseconds by series and size


def doublings(most: int) -> list[int]:
    """1, 2, 4 and so on, and ``most`` itself."""
    return sorted({*(2**i for i in range(most.bit_length())), most})


def random_tree(nodes: int, seed: int = 0) -> gctd3.KinematicGraph:
    """A tree in which every node but the first hangs from a random earlier one."""
    rng = np.random.default_rng(seed)
    names = [f"node{i}" for i in range(nodes)]
    return gctd3.KinematicGraph.from_edges(names, [(names[rng.integers(i)], names[i]) for i in range(1, nodes)])


def stepping(robots: int, threads: int) -> Callable[[], float]:
    """Steps of the environment that training uses, with resets; returns how many of all robots."""
    env = build_env(WalkingTask(gctd3.Robot.from_mjcf("biped")), EnvSettings(num_envs=robots, threads=threads), 0)
    steps = min(200, max(5, FRAMES // robots))
    state = [env.reset()]

    def run() -> float:
        torch.set_num_threads(threads)
        for _ in range(steps):
            action = torch.rand(env.action_spec.shape) * 2 - 1
            _, state[0] = env.step_and_maybe_reset(state[0].set("action", action))
        return steps

    return run


def updating(network: Network, nodes: int, batch: int, threads: int) -> Callable[[], float]:
    """Updates of our TD3 on one random batch; returns how many."""
    algorithm = TD3Settings().build(Architecture(random_tree(nodes), network, FEATURES, ACTIONS))
    done = torch.rand(batch, 1) < 0.02
    following = {"nodes": torch.randn(batch, nodes, FEATURES), "reward": torch.randn(batch, 1)}
    ends = {"done": done, "terminated": done}
    current = {"nodes": torch.randn(batch, nodes, FEATURES), "action": torch.rand(batch, ACTIONS) * 2 - 1}
    data = TensorDict({**current, "next": TensorDict({**following, **ends}, [batch])}, [batch])

    def run() -> float:
        torch.set_num_threads(threads)
        for _ in range(UPDATES):
            algorithm.update(data)
        return UPDATES

    return run


def measure(make: dict[str, Callable[[int], Callable[[], float]]], sizes: list[int], rounds: int) -> Times:
    """Milliseconds of one piece of every series at every size, all taken in turn."""
    work = {(name, size): build(size) for name, build in make.items() for size in sizes}
    found = rates(work, rounds)
    return {name: {size: 1e3 / found[name, size] for size in sizes} for name in make}


def table(title: str, axis: str, times: Times) -> str:
    """Sizes down, series across."""
    lines = [f"\n{title}", f"{axis:>10}" + "".join(f"{name:>24}" for name in times)]
    sizes = next(iter(times.values()))
    lines += [f"{n:>10,}" + "".join(f"{series[n]:>21.3f} ms" for series in times.values()) for n in sizes]
    return "\n".join(lines)


def per_robot(times: Times) -> Times:
    """Microseconds a robot of the times of steps of all robots, under the panel's names."""
    return {name: {size: 1e3 * value / size for size, value in series.items()} for name, series in times.items()}


def draw(panels: dict[str, Times], file: Path) -> None:
    """The four panels."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator

    labels = {
        "robots": ("Environment: cost of a robot's step", "robots stepped at once", "µs per robot and step"),
        "nodes": (f"Update against nodes (batch {BATCH})", "nodes of the graph", "ms per TD3 update"),
        "batch": (f"Update against batch ({NODES} nodes)", "batch size", "ms per TD3 update"),
        "threads": (f"Threads (updates: batch {BATCH}, {NODES} nodes)", "threads", "speed-up over one thread"),
    }
    figure, axes = plt.subplots(2, 2, figsize=(10, 7.5), layout="constrained")
    for (key, (title, x, y)), ax in zip(labels.items(), axes.flat, strict=True):
        times = per_robot(panels[key]) if key == "robots" else panels[key]
        if key == "threads":
            times = {name: {n: series[1] / ms for n, ms in series.items()} for name, series in times.items()}
        sizes = list(next(iter(times.values())))
        for i, (name, series) in enumerate(times.items()):
            ax.plot(sizes, list(series.values()), marker="osD^v"[i % 5], label=name)
        ax.set(title=title, xlabel=x, ylabel=y, xscale="log")
        if key == "threads":
            ax.plot(sizes, sizes, color="0.6", linestyle="--", label="ideal")
            ax.set_ylim(bottom=0)
        else:
            ax.set_yscale("log")
            ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        ax.xaxis.set_major_locator(FixedLocator(sizes))
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_minor_locator(NullLocator())
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,g}"))
        ax.grid(True, which="major", alpha=0.3)
        ax.legend(frameon=False)
    figure.savefig(file, dpi=130)


def main() -> None:
    """Measure, print, write, draw."""
    given = options(
        out="",
        plot="",
        rounds="5",
        threads="1",
        robots="1,4,16,64,256,1024",
        nodes="8,16,32,64",
        batches="64,128,256,512,1024,2048",
        cores=",".join(map(str, doublings(cores()))),
    )
    if given["plot"] and importlib.util.find_spec("matplotlib") is None:
        raise SystemExit("plot= needs matplotlib: pip install 'gctd3[bench]'")
    sizes = {key: [int(text) for text in given[key].split(",")] for key in ("robots", "nodes", "batches", "cores")}
    rounds, threads = int(given["rounds"]), int(given["threads"])
    # A speed-up is over one thread.
    counts = sorted({1, *sizes["cores"]})
    torch.manual_seed(0)

    def updates(build: Callable[[Network, int], Any]) -> dict[str, Callable[[int], Callable[[], float]]]:
        return {name: lambda size, n=network: build(n, size) for name, network in NETWORKS.items()}

    on = f"{threads} thread{'s' if threads > 1 else ''}"
    panels: dict[str, Times] = {
        "robots": measure({f"batched, {on}": lambda size: stepping(size, threads)}, sizes["robots"], rounds)
    }
    print(table("A control step of all robots", "robots", panels["robots"]), flush=True)
    panels["nodes"] = measure(updates(lambda n, size: updating(n, size, BATCH, threads)), sizes["nodes"], rounds)
    print(table(f"A TD3 update, batch {BATCH}, {on}", "nodes", panels["nodes"]), flush=True)
    panels["batch"] = measure(updates(lambda n, size: updating(n, NODES, size, threads)), sizes["batches"], rounds)
    print(table(f"A TD3 update, {NODES} nodes, {on}", "batch", panels["batch"]), flush=True)
    parallel = {f"step of {robots:,} robots": lambda size, r=robots: stepping(r, size) for robots in ROBOTS}
    parallel |= {
        f"update, {name}": make for name, make in updates(lambda n, size: updating(n, NODES, BATCH, size)).items()
    }
    panels["threads"] = measure(parallel, counts, rounds)
    print(table(f"With threads (updates: batch {BATCH}, {NODES} nodes)", "threads", panels["threads"]))
    figures = {"unit": "milliseconds, median", "threads": threads, "cores": cores(), "panels": panels}
    report("scaling", figures, given["out"])
    if given["plot"]:
        draw(panels, Path(given["plot"]))


if __name__ == "__main__":
    main()
