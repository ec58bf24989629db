"""Measure the gain of the hand-optimised arithmetic of gctd3.nn.kernels over its plain versions, as ratios of times.

    python benchmarks/kernels.py [out=FILE.json] [rounds=100]

One thread, batch 256, the paper's networks: twin critics of 256 and 256 units, ten features in a node. Plain and fast
are taken in turn, ``rounds`` times, and the best time of each counts.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import torch
from common import options, report
from tensordict import TensorDict
from torch import nn

import gctd3
from gctd3.algorithms.adam import Adam
from gctd3.algorithms.base import Architecture
from gctd3.algorithms.settings import TD3Settings
from gctd3.nn import Network, kernels

BATCH, CALLS, ROBOTS, HISTORY = 256, 5, 32, 5


def td3() -> Callable[[], object]:
    """A whole update of TD3's critics and actor, with the default network; plain with TorchRL's vmap."""
    graph = gctd3.KinematicGraph.from_mjcf("biped")
    algorithm = TD3Settings(policy_delay=1).build(Architecture(graph, Network(norm="layer"), 10, 6))
    done = torch.zeros(BATCH, 1, dtype=torch.bool)
    following = {"nodes": torch.randn(BATCH, 8, 10), "reward": torch.randn(BATCH, 1), "terminated": done, "done": done}
    seen = {"nodes": torch.randn(BATCH, 8, 10), "action": torch.rand(BATCH, 6)}
    batch = TensorDict({**seen, "next": following}, [BATCH])
    return lambda: algorithm.update(batch)


def stack() -> Callable[[], object]:
    """The same with the critics as one batched module in both."""
    with kernels.use_plain(False):
        return td3()


def critics() -> list[nn.Parameter]:
    """The parameters of the fully connected layers of twin critics: 134 inputs, 256 and 256 units, a value."""
    sizes = [(2, 256, 134), (2, 256), (2, 256, 256), (2, 256), (2, 1, 256), (2, 1)]
    return [nn.Parameter(0.05 * torch.randn(size)) for size in sizes]


def layers() -> Callable[[], object]:
    """The critics' fully connected layers, forwards and backwards."""
    parameters, x = critics(), torch.randn(2, BATCH, 134)

    def both() -> None:
        for parameter in parameters:
            parameter.grad = None
        kernels.stacked_layers(x, *parameters).sum().backward()

    return both


def adam() -> Callable[[], object]:
    """A step of Adam with these parameters."""
    parameters = critics()
    gradients = [torch.randn_like(p) for p in parameters]
    state = [[torch.zeros_like(p) for p in parameters] for _ in range(2)]
    steps = [torch.zeros(()) for _ in parameters]
    group = {"lr": 3e-4, "betas": (0.9, 0.999), "eps": 1e-8, "weight_decay": 0.0}

    @torch.no_grad()
    def step() -> None:
        kernels.adam_step(parameters, gradients, *state, steps, group)

    return step


def optimizer() -> Callable[[], object]:
    """The same as a training takes it: plain, PyTorch's own fused Adam."""
    parameters = critics()
    for parameter in parameters:
        parameter.grad = torch.randn_like(parameter)
    kind = torch.optim.Adam(parameters, lr=3e-4, fused=True) if kernels.plain() else Adam(parameters, lr=3e-4)
    return kind.step


def lerp() -> Callable[[], object]:
    """An update of their targets."""
    sources, targets = [p.data for p in critics()], [p.data for p in critics()]
    return lambda: kernels.lerp_all(targets, sources, 0.005)


def frames() -> Callable[[], object]:
    """A batch of histories out of a ring of 100,000 frames."""
    size = 100_000 // ROBOTS * ROBOTS
    ring, age = torch.randn(size, 8, 2), torch.full((size,), HISTORY - 1, dtype=torch.uint8)
    place, back = torch.randint(size, (BATCH,)), torch.arange(HISTORY - 1, -1, -1)
    return lambda: kernels.stack_frames(ring, age, place, back, ROBOTS)


def best(call: Callable[[], object]) -> float:
    """Seconds of the processor for one call, over several: others on the machine do not count."""
    start = time.process_time()
    for _ in range(CALLS):
        call()
    return (time.process_time() - start) / CALLS


def main() -> None:
    """Measure and print."""
    chosen = options(out="", rounds="100")
    torch.set_num_threads(1)
    gains: dict[str, object] = {}
    for make in (layers, adam, optimizer, lerp, frames, stack, td3):
        calls = {}
        for plain in (True, False):
            with kernels.use_plain(plain):  # losses decide when they are made
                calls[plain] = make()
        times: dict[bool, list[float]] = {True: [], False: []}
        for _ in range(int(chosen["rounds"])):
            for plain, call in calls.items():
                with kernels.use_plain(plain):
                    times[plain].append(best(call))
        gains[make.__name__] = round(min(times[True]) / min(times[False]), 2)
        print(f"{make.__name__:10} plain / fast {gains[make.__name__]}  ({(make.__doc__ or '').strip()})", flush=True)
    report("kernels", {"plain_over_fast": gains}, chosen["out"])


if __name__ == "__main__":
    main()
