#!/usr/bin/env bash
# Expected: Stable-Baselines3's PPO, given a PettingZoo environment through SuperSuit, as PettingZoo's tutorials do,
#   knows a fall from the time limit, as it does with a Gymnasium environment: after the time limit it adds the value of
#   the last observation to the last reward.
# Instead: SuperSuit makes one "done" of termination and truncation and passes nothing on (SB3 looks for
#   infos["TimeLimit.truncated"]); both ends look the same. With a value of 10 and a reward of 1, the last step of an
#   episode cut by the time limit is worth 1 instead of 10.9.
# Versions: supersuit 3.11.0, pettingzoo 1.27.0, stable-baselines3 2.9.2, gymnasium 1.3.0, torch 2.13.0.
# Matters for: multi-agent robots (Gymnasium-Robotics' MaMuJoCo), whose good episodes all end at the time limit, and
#   comparisons of one agent with several.
# Source: Farama-Foundation/PettingZoo issue 1126, open, of the tutorials with CleanRL; of this wrapper none found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check \
  supersuit==3.11.0 pettingzoo==1.27.0 stable-baselines3==2.9.2 gymnasium==1.3.0 torch==2.13.0 numpy==2.2.6
venv/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import gymnasium
import numpy as np
import supersuit
import torch
from pettingzoo import ParallelEnv
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

LEGS, STEPS, VALUE, GAMMA = ("front", "rear"), 5, 10.0, 0.99
OBSERVATIONS = gymnasium.spaces.Box(0, STEPS, (1,), np.float32)
ACTIONS = gymnasium.spaces.Box(-1, 1, (1,), np.float32)


class One(gymnasium.Env):
    """Each step is worth 1; the last one is a fall or the time limit's."""

    observation_space, action_space = OBSERVATIONS, ACTIONS

    def __init__(self, falls):
        self.falls = falls

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        return np.zeros(1, np.float32), {}

    def step(self, action):
        self.steps += 1
        last = self.steps == STEPS
        return np.array([self.steps], np.float32), 1.0, last and self.falls, last and not self.falls, {}


class Two(ParallelEnv):
    """The same with two agents, which end together."""

    metadata, render_mode, possible_agents = {"name": "two"}, None, list(LEGS)

    def __init__(self, falls):
        self.one = One(falls)

    def observation_space(self, agent):
        return OBSERVATIONS

    def action_space(self, agent):
        return ACTIONS

    def reset(self, seed=None, options=None):
        self.agents = list(LEGS)
        return ({leg: part for leg in LEGS} for part in self.one.reset(seed=seed))

    def step(self, actions):
        observation, reward, terminated, truncated, _ = self.one.step(None)
        if terminated or truncated:
            self.agents = []
        parts = (dict.fromkeys(LEGS, part) for part in (observation, reward, terminated, truncated))
        return *parts, {leg: {} for leg in LEGS}


def gymnasium_vector(falls):
    return make_vec_env(lambda: One(falls), n_envs=2)


def supersuit_vector(falls):
    vector = supersuit.pettingzoo_env_to_vec_env_v1(Two(falls))
    return supersuit.concat_vec_envs_v1(vector, 1, num_cpus=0, base_class="stable_baselines3")


def rewards(env):
    """Return the first agent's rewards of one episode as PPO stores them, with a critic that says VALUE everywhere."""
    model = PPO("MlpPolicy", env, n_steps=STEPS, batch_size=2 * STEPS, n_epochs=1, gamma=GAMMA, device="cpu")
    with torch.no_grad():
        model.policy.value_net.weight.zero_()
        model.policy.value_net.bias.fill_(VALUE)
    _, callback = model._setup_learn(2 * STEPS)
    model.collect_rollouts(env, callback, model.rollout_buffer, STEPS)
    return model.rollout_buffer.rewards[:, 0].tolist()


print(*(f"{name} {version(name)}" for name in ("supersuit", "pettingzoo", "stable-baselines3", "gymnasium", "torch")))
for make in (gymnasium_vector, supersuit_vector):
    for falls in (True, False):
        found = rewards(make(falls))
        print(f"{make.__name__:16}, {'a fall' if falls else 'the time limit':14}: rewards {np.round(found, 2)}")
        bootstrapped = make is gymnasium_vector and not falls
        assert np.allclose(found, [1] * (STEPS - 1) + [1 + GAMMA * VALUE * bootstrapped], atol=0.01)
PY
