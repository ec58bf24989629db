"""A graph network in a pipeline that is not this library's: TorchRL's PPO on dm_control's walker.

The environment, the collector, the advantage and the loss are TorchRL's; of gctd3 there are the nodes that the
environment writes, the graph, and :class:`gctd3.nn.GraphEncoder` in front of TorchRL's MLPs.

    python examples/ppo_walker.py --frames 1000000

PPO: Schulman et al. 2017, arXiv:1707.06347. Advantages: Schulman et al. 2016, arXiv:1506.02438.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import torch
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, SamplerWithoutReplacement, TensorDictReplayBuffer
from torchrl.envs import DMControlEnv, InitTracker, RewardSum
from torchrl.modules import MLP, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from gctd3 import KinematicGraph
from gctd3.envs.nodes import with_nodes
from gctd3.nn import GraphEncoder


def encoded(graph: KinematicGraph, features: int, outputs: int) -> list[nn.Module]:
    """Two graph convolutions, then an MLP: ``[*, N, features]`` to ``[*, outputs]``."""
    encoder = GraphEncoder(graph, features, (32, 32))
    return [encoder, MLP(encoder.out_features, outputs, num_cells=[64, 64], activation_class=nn.Tanh)]


def main(arguments: Sequence[str] | None = None) -> float:
    """Train.

    Returns:
        Mean reward of a step in the last batch, in [0, 1].
    """
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--domain", default="walker", help="of dm_control's suite")
    parser.add_argument("--task", default="walk", help="of that domain")
    parser.add_argument("--frames", type=int, default=1_000_000, help="control steps in all")
    parser.add_argument("--batch", type=int, default=2_000, help="control steps between updates")
    parser.add_argument("--epochs", type=int, default=10, help="passes over a batch")
    parser.add_argument("--minibatch", type=int, default=200, help="control steps in a gradient step")
    parser.add_argument("--learning-rate", type=float, default=3e-4, help="of Adam")
    parser.add_argument("--seed", type=int, default=0, help="of everything")
    options = parser.parse_args(arguments)

    torch.manual_seed(options.seed)
    env = with_nodes(DMControlEnv(options.domain, options.task), history=2)
    graph = env.transform[0].sensor.graph
    env.append_transform(InitTracker())
    env.append_transform(RewardSum())
    env.set_seed(options.seed)
    print(graph)

    features, actions = env.observation_spec["nodes"].shape[-1], env.action_spec.shape[-1]
    actor = ProbabilisticActor(
        TensorDictModule(
            nn.Sequential(*encoded(graph, features, 2 * actions), NormalParamExtractor()), ["nodes"], ["loc", "scale"]
        ),
        in_keys=["loc", "scale"],
        spec=env.action_spec,
        distribution_class=TanhNormal,
        return_log_prob=True,
    )
    critic = ValueOperator(nn.Sequential(*encoded(graph, features, 1)), in_keys=["nodes"])
    loss = ClipPPOLoss(actor, critic, clip_epsilon=0.2, entropy_coeff=1e-3, normalize_advantage=True)
    advantage = GAE(gamma=0.99, lmbda=0.95, value_network=critic)
    adam = torch.optim.Adam(loss.parameters(), lr=options.learning_rate)
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(options.batch),
        sampler=SamplerWithoutReplacement(),
        batch_size=options.minibatch,
    )
    collector = Collector(env, actor, frames_per_batch=options.batch, total_frames=options.frames)
    frames, reward = 0, 0.0
    for collected in collector:
        frames += collected.numel()
        for _ in range(options.epochs):
            with torch.no_grad():
                advantage(collected)
            buffer.empty()
            buffer.extend(collected.reshape(-1))
            for minibatch in buffer:
                terms = loss(minibatch)
                adam.zero_grad()
                sum(terms[key] for key in ("loss_objective", "loss_critic", "loss_entropy")).backward()
                nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
                adam.step()
        reward = collected["next", "reward"].mean().item()
        ended = collected["next", "episode_reward"][collected["next", "done"]]
        returns = f"{ended.mean():.0f}" if len(ended) else "-"
        print(f"{frames:>9,} steps  reward a step {reward:.3f}  return of ended episodes {returns}", flush=True)
    collector.shutdown()
    return reward


if __name__ == "__main__":
    main()
