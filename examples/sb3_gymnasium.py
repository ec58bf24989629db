"""Stable-Baselines3's TD3, SAC or PPO on a Gymnasium robot, with a graph network as their features extractor.

The algorithm, its buffer and its fully connected layers are Stable-Baselines3's; of gctd3 there are the nodes that the
environment observes, the graph, and the graph convolutions of ``gctd3.sb3.GraphExtractor``.

    python examples/sb3_gymnasium.py --algo td3 --env HalfCheetah-v5 --frames 200000 --save cheetah

TD3: Fujimoto et al. 2018, arXiv:1802.09477; SAC: Haarnoja et al. 2018, arXiv:1812.05905; PPO: Schulman et al. 2017,
arXiv:1707.06347.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import gymnasium
import numpy as np
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.noise import NormalActionNoise

from gctd3.sb3 import GraphExtractor, NodeObservation

ALGORITHMS = {"td3": TD3, "sac": SAC, "ppo": PPO}


def main(arguments: Sequence[str] | None = None) -> float:
    """Train, and give the mean return of five episodes of the deterministic policy."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--algo", choices=ALGORITHMS, default="td3", help="algorithm")
    parser.add_argument("--env", default="HalfCheetah-v5", help="a MuJoCo robot of Gymnasium")
    parser.add_argument("--frames", type=int, default=200_000, help="control steps")
    parser.add_argument("--history", type=int, default=2, help="frames that a node observes")
    parser.add_argument("--seed", type=int, default=0, help="of everything")
    parser.add_argument("--save", help="file to save the model to")
    options = parser.parse_args(arguments)

    env = NodeObservation(gymnasium.make(options.env), history=options.history)
    more = {}
    if options.algo == "td3":
        zero = np.zeros(env.action_space.shape)
        more["action_noise"] = NormalActionNoise(mean=zero, sigma=zero + 0.1)
    model = ALGORITHMS[options.algo](
        "MultiInputPolicy",
        Monitor(env),
        policy_kwargs={
            "features_extractor_class": GraphExtractor,
            "features_extractor_kwargs": {"graph": env.graph, "hidden": [32, 32, 16]},
        },
        seed=options.seed,
        verbose=1,
        **more,
    )
    model.learn(options.frames)
    if options.save:
        model.save(options.save)
    mean, deviation = evaluate_policy(model, Monitor(env), n_eval_episodes=5)
    print(f"{options.env} {options.algo} after {options.frames:,} steps  return {mean:.0f} ± {deviation:.0f}")
    return float(mean)


if __name__ == "__main__":
    main()
