#!/usr/bin/env bash
# Expected: FrameSkipTransform(4) repeats an action four times, or fewer if the episode ends before: what happens
#   after a fall is not part of the episode.
# Instead: it goes on stepping the ended environment and hands out the last substep's observation and end alone. A
#   fall in the second of four substeps is not reported, the reward of the steps after it is added, and the episode
#   has no end. The frame_skip argument of TorchRL's own GymEnv stops at the end, as expected.
# Versions: torchrl 0.14.1, tensordict 0.14.3, torch 2.13.0, gymnasium 1.3.0.
# Matters for: any robot whose fall is reported once, or that gets up, or that a penalty is paid for at every step.
# Source: none found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check \
  torch==2.13.0 torchrl==0.14.1 tensordict==0.14.3 gymnasium==1.3.0 numpy==2.2.6
venv/bin/python - <<'PY'
from importlib.metadata import version

import gymnasium
import numpy as np
from torchrl.envs import FrameSkipTransform, GymWrapper, TransformedEnv


class FallsAtStepSix(gymnasium.Env):
    """Its observation is the number of steps made, its reward 1 while it stands."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (1,), np.float32)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        return np.zeros(1, np.float32), {}

    def step(self, action):
        self.steps += 1
        return np.full(1, self.steps, np.float32), float(self.steps <= 6), self.steps == 6, False, {}


print(*(f"{name} {version(name)}" for name in ("torchrl", "tensordict", "torch", "gymnasium")))
ends = {}
for name, env in {
    "FrameSkipTransform": TransformedEnv(GymWrapper(FallsAtStepSix()), FrameSkipTransform(4)),
    "frame_skip=": GymWrapper(FallsAtStepSix(), frame_skip=4),
}.items():
    episode = env.rollout(5, break_when_any_done=True)["next"]
    steps, reward, fell = (episode[key].flatten().tolist() for key in ("observation", "reward", "terminated"))
    ends[name] = any(fell)
    print(f"{name:18} steps {steps}, reward {reward}, terminated {fell}")
assert not ends["FrameSkipTransform"] and ends["frame_skip="]
PY
