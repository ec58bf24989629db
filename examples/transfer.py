"""One policy's weights on two robots: a trunk trained on Walker2d goes on on Ant, beside one that starts afresh.

With ``readout="joint"`` one head serves all joints and no weight's shape depends on the robot, so the policy's state
dictionary loads as it is. The six joints of the one and the eight of the other differ to it in what their nodes sense
and in what stands in the nodes' static features. Whether it helps is for you to see: the script prints both returns.

    python examples/transfer.py --source Walker2d-v5 --target Ant-v5 --frames 100000
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from statistics import fmean

import torch
from sac_gymnasium import train

from gctd3.nn import Network


def main(arguments: Sequence[str] | None = None) -> dict[str, float]:
    """Train on the source, then on the target with its weights and without.

    Returns:
        Mean return of the last five episodes on the target, ``transferred`` and from ``scratch``.
    """
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--source", default="Walker2d-v5", help="the robot to learn from")
    parser.add_argument("--target", default="Ant-v5", help="the robot to go on with")
    parser.add_argument("--frames", type=int, default=100_000, help="control steps on each")
    parser.add_argument("--warmup", type=int, default=2_000, help="random control steps before the first gradient step")
    parser.add_argument("--batch", type=int, default=256, help="transitions in a gradient step")
    parser.add_argument("--seed", type=int, default=0, help="of everything")
    parser.add_argument("--save", default="", help="a file for the source's weights")
    options = parser.parse_args(arguments)

    network = Network(norm="layer", graph_norm="layer", residual=True, readout="joint")
    settings = {"frames": options.frames, "warmup": options.warmup, "batch": options.batch, "seed": options.seed}
    actor, _ = train(options.source, network, **settings)
    weights = {name: value.detach().clone() for name, value in actor.state_dict().items()}
    if options.save:
        torch.save(weights, options.save)
    returns = {
        "transferred": train(options.target, network, **settings, initial=weights)[1],
        "scratch": train(options.target, network, **settings)[1],
    }
    result = {name: fmean(episodes[-5:]) if episodes else float("nan") for name, episodes in returns.items()}
    count = sum(value.numel() for value in weights.values())
    print(f"\n{count:,} weights from {options.source} to {options.target}; return of the last five episodes:")
    for name, value in result.items():
        print(f"  {name:12} {value:.1f}")
    return result


if __name__ == "__main__":
    main()
