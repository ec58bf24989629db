#!/usr/bin/env bash
# Expected: skrl stores the same transitions whether it is given one Gymnasium environment or a vector of them: an
#   episode of three steps is three transitions, the last one with the end.
# Instead: a Gymnasium vector, as it is by default since 1.0, resets an environment in the step after its end: that step
#   ignores the action and returns the new episode's first observation with reward 0. skrl's wrapper and trainer take it
#   for a step like others. Each episode gets one transition more, from the fallen robot to the next start, free of cost
#   and not an end. After the time limit, which the off-policy agents (DDPG, TD3, SAC, DQN) do not store, two episodes
#   become one: an episode's last state is worth what a new start is worth. With AutoresetMode.SAME_STEP there is no
#   such step, but the next observation of an episode's last transition is the new start.
# Versions: skrl 2.1.1, gymnasium 1.3.0, torch 2.13.0.
# Matters for: all of skrl's agents with several Gymnasium environments, most so for short episodes, such as those at
#   the start of training: of episodes with 20 steps, every 21st transition is made up.
# Source: Gymnasium's page on autoreset modes; of skrl none found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check skrl==2.1.1 gymnasium==1.3.0 torch==2.13.0 numpy==2.2.6
venv/bin/python - <<'PY'
from importlib.metadata import version

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from skrl.agents.torch.dqn import DQN
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.trainers.torch import SequentialTrainer


class Robot(gymnasium.Env):
    """Observes how many steps it has done since the start; the third one costs 8 and ends the episode."""

    observation_space = gymnasium.spaces.Box(0, 3, (1,), np.float32)
    action_space = gymnasium.spaces.Discrete(2)

    def __init__(self, falls):
        self.falls = falls

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.done = 0
        return np.zeros(1, np.float32), {}

    def step(self, action):
        self.done += 1
        last = self.done == 3
        observation, reward = np.array([self.done], np.float32), -8.0 if last else 1.0
        return observation, reward, last and self.falls, last and not self.falls, {}


def stored(env, steps=8):
    """Return the transitions (observation, reward, next observation, end) of the first environment."""
    env = wrap_env(env, wrapper="gymnasium", verbose=False)
    memory = RandomMemory(memory_size=steps, num_envs=env.num_envs)
    agent = DQN(
        models={},
        memory=memory,
        observation_space=env.observation_space,
        state_space=env.state_space,
        action_space=env.action_space,
        cfg={"learning_starts": 10 * steps, "experiment": {"write_interval": 0, "checkpoint_interval": 0}},
    )
    agent.act = lambda observations, states, **_: (torch.zeros(env.num_envs, 1, dtype=torch.int64), {})
    settings = {"timesteps": steps, "headless": True, "disable_progressbar": True}
    SequentialTrainer(env=env, agents=agent, cfg=settings).train()
    names = ("observations", "rewards", "next_observations", "terminated")  # truncated is not there
    return [
        (int(before), int(reward), int(after), bool(end))
        for before, reward, after, end in zip(*(memory.get_tensor_by_name(name)[:, 0, 0] for name in names))
    ]


def vector(falls, **keywords):
    return SyncVectorEnv([lambda: Robot(falls)] * 2, **keywords)


print(*(f"{name} {version(name)}" for name in ("skrl", "gymnasium", "torch")))
for falls in (True, False):
    print("the third step is", "a fall:" if falls else "the time limit's:")
    for name, env, after in (
        ("one environment", Robot(falls), [(2, -8, 3, falls)]),
        ("vector of two", vector(falls), [(2, -8, 3, falls), (3, 0, 0, False)]),
        ("SAME_STEP", vector(falls, autoreset_mode=AutoresetMode.SAME_STEP), [(2, -8, 0, falls)]),
    ):
        found = stored(env)
        print(f"  {name:16}", *found[:6])
        episode = [(0, 1, 1, False), (1, 1, 2, False), *after]
        assert found == (3 * episode)[: len(found)]
PY
