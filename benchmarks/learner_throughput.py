"""Updates per second of our TD3, stock TorchRL's, Stable-Baselines3's and SBX's, side by side.

    python benchmarks/learner_throughput.py [out=FILE.json] [rounds=5] [batches=64,256,1024] [threads=2]

An update is everything a learner does for one: draw a batch, critic step, and every second time actor and targets. All
hold the same random transitions of the biped, and networks of two layers of 256 units (GCN: the paper's). Peers that
are not installed (``pip install 'gctd3[bench]'``) are left out and named. ``by_hand.py`` bounds what can be had: the
MLP's arithmetic on one batch, with nothing around it.
"""

from __future__ import annotations

import importlib.util
import logging
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from by_hand import TD3ByHand
from common import options, rates, report
from tensordict import TensorDict, TensorDictBase
from torch.utils.flop_counter import FlopCounterMode
from torchrl import torchrl_logger
from torchrl.objectives import SoftUpdate
from torchrl.objectives import TD3Loss as StockTD3Loss

import gctd3
from gctd3.algorithms.base import Architecture, minimize
from gctd3.algorithms.settings import TD3Settings
from gctd3.data.replay import Replay
from gctd3.data.settings import ReplaySettings
from gctd3.nn import Network

HELD, UPDATES = 20_000, 20  # transitions in each buffer; updates timed at once
ROBOTS, NODES, FEATURES, ACTIONS, COUNTERS = 20, 8, 10, 6, 4
NETWORKS = {"GCN": Network(norm="none"), "MLP": Network(graph_layers=(), norm="none")}  # the paper's


def transitions() -> TensorDictBase:
    """Random episodes of the biped's shapes, batch size ``[ROBOTS, HELD // ROBOTS]``."""
    torch.manual_seed(0)
    shape = (ROBOTS, HELD // ROBOTS)
    done = torch.rand(*shape, 1) < 0.02
    step_count = torch.zeros(*shape, 1, dtype=torch.int64)
    for t in range(1, shape[1]):
        step_count[:, t] = torch.where(done[:, t - 1], 0, step_count[:, t - 1] + 1)
    following = {
        "nodes": torch.randn(*shape, NODES, FEATURES),
        "counters": torch.randn(*shape, COUNTERS),
        "reward": torch.randn(*shape, 1),
        "done": done,
        "terminated": done,
        "truncated": torch.zeros_like(done),
    }
    current = {
        "nodes": torch.randn(*shape, NODES, FEATURES),
        "counters": torch.randn(*shape, COUNTERS),
        "action": torch.rand(*shape, ACTIONS) * 2 - 1,
        "step_count": step_count,
    }
    return TensorDict({**current, "next": TensorDict(following, shape)}, shape)


def ours(network: Network, batch: int, data: TensorDictBase, graph: gctd3.KinematicGraph) -> Callable[[], Any]:
    """Our TD3 and replay."""
    algorithm = TD3Settings().build(Architecture(graph, network, FEATURES, ACTIONS))
    replay = Replay(ReplaySettings(buffer_size=HELD, batch_size=batch, n_step=1, mirror=False), gamma=0.99)
    replay.extend(data)
    return lambda: algorithm.update(replay.sample())


def stock(network: Network, batch: int, data: TensorDictBase, graph: gctd3.KinematicGraph) -> Callable[[], Any]:
    """TorchRL's loss over the same networks and replay, with PyTorch's default Adam, as TorchRL's examples do."""
    architecture = Architecture(graph, network, FEATURES, ACTIONS)
    critics = [architecture.critic() for _ in range(2)]
    loss = StockTD3Loss(architecture.actor(), critics, bounds=(-1.0, 1.0), loss_function="l2")
    loss.make_value_estimator(gamma=0.99)
    targets = SoftUpdate(loss, tau=0.005)

    def adam(parameters: TensorDictBase) -> torch.optim.Adam:
        return torch.optim.Adam([p for p in parameters.values(True, True) if p.requires_grad], lr=3e-4)

    critic, actor = adam(loss.qvalue_network_params), adam(loss.actor_network_params)
    settings = ReplaySettings(buffer_size=HELD, batch_size=batch, n_step=1, mirror=False, storage="stacked")
    replay = Replay(settings, gamma=0.99)
    replay.extend(data)
    count = 0

    def update() -> None:
        nonlocal count
        count += 1
        drawn = replay.sample()
        minimize(critic, loss.value_loss(drawn)[0])
        if count % 2 == 0:
            minimize(actor, loss.actor_loss(drawn)[0])
            targets.step()

    return update


def stable_baselines(package: str, batch: int, data: TensorDictBase) -> Callable[[], Any]:
    """Stable-Baselines3's (``stable_baselines3``) or SBX's (``sbx``, JAX) TD3 with its own replay."""
    import gymnasium

    module = __import__(package)
    env = gymnasium.wrappers.FlattenObservation(gymnasium.make("gctd3/Biped-v0"))
    model = module.TD3(
        "MlpPolicy",
        env,
        learning_rate=3e-4,
        buffer_size=HELD,
        batch_size=batch,
        learning_starts=0,
        policy_kwargs={"net_arch": [256, 256]},
        device="cpu" if package == "stable_baselines3" else "auto",
    )
    model._setup_learn(HELD)
    flat = data.reshape(-1)
    nodes, following = flat["nodes"].flatten(1).numpy(), flat["next", "nodes"].flatten(1).numpy()
    action, reward = flat["action"].numpy(), flat["next", "reward"].numpy()
    done = flat["next", "terminated"].numpy()
    for i in range(HELD):
        model.replay_buffer.add(nodes[i], following[i], action[i], reward[i], done[i], [{}])
    return lambda: model.train(gradient_steps=1, batch_size=batch)


def matrix_rate(size: int = 1024) -> float:
    """FLOP/s of one large float32 matrix product on this machine, best of ten."""
    a, b = torch.randn(size, size), torch.randn(size, size)
    best = math.inf
    for _ in range(10):
        began = time.perf_counter()
        a @ b
        best = min(best, time.perf_counter() - began)
    return 2 * size**3 / best


def flops(update: Callable[[], Any]) -> float:
    """Floating-point operations of an update, averaged over two (one with and one without the actor)."""
    with FlopCounterMode(display=False) as counter:
        update()
        update()
    return counter.get_total_flops() / 2


def main() -> None:
    """Measure, print, write."""
    given = options(out="", rounds="5", batches="64,256,1024", threads="2")
    torch.set_num_threads(int(given["threads"]))
    np.random.seed(0)
    torchrl_logger.setLevel(logging.WARNING)
    data, graph = transitions(), gctd3.KinematicGraph.from_mjcf("biped")
    peak, rows, missing = matrix_rate(), {}, []
    for batch in (int(text) for text in given["batches"].split(",")):
        updates: dict[str, Callable[[], Any]] = {}
        for kind, network in NETWORKS.items():
            updates[f"ours, {kind}"] = ours(network, batch, data, graph)
            updates[f"stock TorchRL, {kind}"] = stock(network, batch, data, graph)
        updates["by hand, MLP"] = TD3ByHand(NODES * FEATURES, ACTIONS, batch).update
        for label, package in (("Stable-Baselines3, MLP", "stable_baselines3"), ("SBX, MLP", "sbx")):
            if importlib.util.find_spec(package) is None:
                missing.append(f"{label}: {package} is not installed")
            else:
                updates[label] = stable_baselines(package, batch, data)

        def work(update: Callable[[], Any]) -> Callable[[], float]:
            def run() -> float:
                for _ in range(UPDATES):
                    update()
                return UPDATES

            return run

        found = rates({name: work(update) for name, update in updates.items()}, int(given["rounds"]))
        print(f"\nbatch {batch}{'':28}{'updates/s':>12}{'ours is x times':>17}{'of peak FLOP/s':>16}")
        for name, rate in found.items():
            mine = found[f"ours, {'GCN' if name.endswith('GCN') else 'MLP'}"]
            share = f"{flops(updates[name]) * rate / peak:.2f}" if name.startswith(("ours", "stock")) else "-"
            print(f"{name:36}{rate:>12.1f}{mine / rate:>17.2f}{share:>16}")
        rows[str(batch)] = found
    for line in dict.fromkeys(missing):
        print(f"not measured: {line}")
    report(
        "learner_throughput",
        {"unit": "updates per second, median", "matrix_product_flops": peak, "batches": rows, "not_measured": missing},
        given["out"],
    )


if __name__ == "__main__":
    main()
