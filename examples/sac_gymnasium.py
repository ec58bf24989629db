"""TorchRL's own SAC on a Gymnasium robot, with graph networks for its policy and its critics.

The loss is ``torchrl.objectives.SACLoss``, the buffer and the collector are TorchRL's too; of gctd3 there are the nodes
that the environment writes, the graph, and the networks of :func:`gctd3.make_stochastic_actor` and
:func:`gctd3.make_critic`.

    python examples/sac_gymnasium.py --env HalfCheetah-v5 --frames 200000

SAC: Haarnoja et al. 2018, arXiv:1812.05905.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import torch
from tensordict.nn import TensorDictModuleBase
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import EnvBase, GymEnv, InitTracker, RewardSum
from torchrl.objectives import SACLoss, SoftUpdate, ValueEstimators

from gctd3 import KinematicGraph, make_critic, make_stochastic_actor
from gctd3.envs.nodes import with_nodes
from gctd3.nn import Network


def make(name: str, seed: int) -> tuple[EnvBase, KinematicGraph]:
    """A Gymnasium robot whose nodes sense two frames and know what they are, and its graph."""
    env = with_nodes(GymEnv(name), history=2, static=True)
    graph = env.transform[0].sensor.graph
    env.append_transform(InitTracker())
    env.append_transform(RewardSum())
    env.set_seed(seed)
    return env, graph


def train(
    name: str,
    network: Network,
    frames: int,
    warmup: int = 2_000,
    batch: int = 256,
    seed: int = 0,
    initial: dict[str, torch.Tensor] | None = None,
) -> tuple[TensorDictModuleBase, list[float]]:
    """Train on one robot; from the weights ``initial`` of another policy if there are any.

    Returns:
        The policy, and the returns of the episodes that ended, in order.
    """
    torch.manual_seed(seed)
    env, graph = make(name, seed)
    sizes = env.observation_spec["nodes"].shape[-1], env.action_spec.shape[-1]
    actor = make_stochastic_actor(graph, *sizes, network)
    if initial is not None:
        actor.load_state_dict(initial)
    loss = SACLoss(actor, [make_critic(graph, *sizes, network) for _ in range(2)], action_spec=env.action_spec)
    loss.make_value_estimator(ValueEstimators.TD0, gamma=0.99)
    target = SoftUpdate(loss, tau=0.005)
    adam = torch.optim.Adam([p for p in loss.parameters() if p.requires_grad], lr=3e-4)
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(frames), batch_size=batch)
    # An actor that comes trained collects from the first step on.
    random = min(warmup, frames) if initial is None else 0
    collector = Collector(env, actor, frames_per_batch=20, total_frames=frames // 20 * 20, init_random_frames=random)
    seen, returns = 0, []
    for collected in collector:
        seen += collected.numel()
        ended = collected["next", "episode_reward"][collected["next", "done"]]
        returns += ended.tolist()
        if len(ended):
            print(f"{name} {seen:>9,} steps  return {returns[-1]:.0f}", flush=True)
        keys = ("nodes", "action", ("next", "nodes"), ("next", "reward"), ("next", "terminated"), ("next", "done"))
        buffer.extend(collected.select(*keys).reshape(-1))
        for _ in range(collected.numel() if seen > min(warmup, frames // 2) else 0):
            terms = loss(buffer.sample())
            adam.zero_grad()
            (terms["loss_actor"] + terms["loss_qvalue"] + terms["loss_alpha"]).backward()
            adam.step()
            target.step()
    collector.shutdown()
    return actor, returns


def main(arguments: Sequence[str] | None = None) -> list[float]:
    """Train, and give the returns of the episodes that ended."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--env", default="HalfCheetah-v5", help="a MuJoCo robot of Gymnasium")
    parser.add_argument("--frames", type=int, default=200_000, help="control steps, each with a gradient step")
    parser.add_argument("--warmup", type=int, default=2_000, help="random control steps before the first")
    parser.add_argument("--batch", type=int, default=256, help="transitions in a gradient step")
    parser.add_argument("--seed", type=int, default=0, help="of everything")
    options = parser.parse_args(arguments)
    network = Network()
    return train(options.env, network, options.frames, options.warmup, options.batch, options.seed)[1]


if __name__ == "__main__":
    main()
