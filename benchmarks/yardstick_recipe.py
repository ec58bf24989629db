"""The hyperparameters that both sides of ``benchmarks/yardsticks.py`` train with, and how each side is told them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

# By the name of conf/env: Gymnasium's.
TASKS = {"halfcheetah": "HalfCheetah-v5", "walker2d": "Walker2d-v5"}
ALGORITHMS = ("td3", "sac", "ddpg")


@dataclass(frozen=True)
class Recipe:
    """One set of values for all algorithms: Spinning Up's defaults. Batches of 100 are TD3's authors' too.

    Unlike there, updates begin after the random steps, and SAC's temperature is learned.

    One robot; after every step one update of the critics. An MLP with ReLU and PyTorch's initial weights, and nothing
    that the other side lacks: single-step returns, no normalisation, the trained actor evaluated, not an average of it;
    SAC's deviation as its authors make it (``algo.scale=exp``).

    With the same weights, transitions and draws both sides make the same updates
    (``tests/benchmarks/test_yardstick_updates.py``); with the same starts and draws both keep the same transitions, get
    the same returns and train the same weights (``tests/benchmarks/test_yardstick_data.py``). What is left: theirs adds
    TD3's and DDPG's noise to the uniform actions too, updates first one step later, may draw the newest transition, and
    adds 1e-6 to what it takes SAC's logarithm of.

    Attributes:
        learning_rate: Learning rate of Adam, for every network and SAC's temperature.
        batch_size: Transitions of an update.
        capacity: Transitions kept.
        gamma: Discount factor.
        tau: Share of the trained parameters that enters the targets.
        hidden: Units of actor and critics.
        random_steps: Steps with uniform actions, before the first update.
        action_noise: Standard deviation of the noise on TD3's and DDPG's actions.
        policy_delay: TD3's critic updates for each update of the actor and the targets.
        policy_noise: Standard deviation of the noise on TD3's target actions.
        noise_clip: Largest size of that noise.
        temperature: SAC's first; it is learned, for an entropy of minus the number of actions.
    """

    learning_rate: float = 1e-3
    batch_size: int = 100
    capacity: int = 1_000_000
    gamma: float = 0.99
    tau: float = 0.005
    hidden: tuple[int, ...] = (256, 256)
    random_steps: int = 10_000
    action_noise: float = 0.1
    policy_delay: int = 2
    policy_noise: float = 0.2
    noise_clip: float = 0.5
    temperature: float = 1.0


def ours(algo: str, task: str, recipe: Recipe) -> list[str]:
    """The command line of ``python -m gctd3.train``, but for the seed and how long and where."""
    noise = "null" if algo == "sac" else f"[{recipe.action_noise},{recipe.action_noise}]"
    common = {
        "algo": algo,
        "task": task,
        "task.observation": "flat",
        "env.num_envs": 1,
        "task.history": 1,
        "rollout_steps": 1,
        "gradient_steps": 1,
        "network.hidden": f"[{','.join(map(str, recipe.hidden))}]",
        "network.norm": "none",
        "replay.buffer_size": recipe.capacity,
        "replay.batch_size": recipe.batch_size,
        "replay.n_step": 1,
        "exploration.warmup": "uniform",
        "exploration.hold": 1,
        "exploration.learning_starts": recipe.random_steps,
        "exploration.noise": noise,
        "algo.learning_rate": recipe.learning_rate,
        "algo.gamma": recipe.gamma,
        "algo.tau": recipe.tau,
        "algo.average_policy": "false",
    }
    own = {
        "td3": {
            "algo.policy_delay": recipe.policy_delay,
            "algo.policy_noise": recipe.policy_noise,
            "algo.noise_clip": recipe.noise_clip,
        },
        "sac": {"algo.alpha": recipe.temperature, "algo.scale": "exp"},
        "ddpg": {},
    }
    return [f"{key}={value}" for key, value in {**common, **own[algo]}.items()]


def theirs(algo: str, task: str, recipe: Recipe, seed: int) -> Any:  # noqa: ANN401 - one of Stable-Baselines3's
    """Stable-Baselines3's algorithm on the task, on the CPU."""
    import stable_baselines3
    from stable_baselines3.common.noise import NormalActionNoise

    env = gymnasium.make(TASKS[task])
    common = {
        "learning_rate": recipe.learning_rate,
        "buffer_size": recipe.capacity,
        "learning_starts": recipe.random_steps,
        "batch_size": recipe.batch_size,
        "tau": recipe.tau,
        "gamma": recipe.gamma,
        "train_freq": 1,
        "gradient_steps": 1,
        "policy_kwargs": {"net_arch": list(recipe.hidden)},
        "seed": seed,
        "device": "cpu",
    }
    own = {
        "td3": {
            "policy_delay": recipe.policy_delay,
            "target_policy_noise": recipe.policy_noise,
            "target_noise_clip": recipe.noise_clip,
        },
        "sac": {"ent_coef": f"auto_{recipe.temperature}", "target_update_interval": 1, "target_entropy": "auto"},
        "ddpg": {},
    }
    if algo != "sac":
        zero = np.zeros(env.action_space.shape)
        common["action_noise"] = NormalActionNoise(mean=zero, sigma=zero + recipe.action_noise)
    return getattr(stable_baselines3, algo.upper())("MlpPolicy", env, **common, **own[algo])
