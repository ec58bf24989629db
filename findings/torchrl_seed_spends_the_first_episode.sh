#!/usr/bin/env bash
# Expected: TorchRL's GymEnv after set_seed(0) begins with the episode of Gymnasium's reset(seed=0), and its
#   DMControlEnv with that of dm_control's suite and random=0.
# Instead: set_seed resets once itself, unseen; the first episode that one gets is the second of that seed.
# Versions: torchrl 0.14.1, torch 2.13.0, gymnasium 1.3.0, dm-control 1.0.50, mujoco 3.17.0.
# Matters for: comparing runs, or recorded episodes, of TorchRL with those of another library at "the same seed".
# Source: none found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check \
  torch==2.13.0 torchrl==0.14.1 tensordict==0.14.3 gymnasium==1.3.0 dm-control==1.0.50 mujoco==3.17.0 numpy==2.2.6
MUJOCO_GL=disable venv/bin/python - <<'PY'
import warnings
from importlib.metadata import version

import gymnasium
import numpy as np

warnings.simplefilter("ignore")
from dm_control import suite  # noqa: E402
from torchrl.envs import DMControlEnv, GymEnv  # noqa: E402

print(*(f"{name} {version(name)}" for name in ("torchrl", "torch", "gymnasium", "dm-control", "mujoco")))


def compare(name, theirs, env, key):
    env.set_seed(0)
    ours = env.reset()[key].numpy()
    same = [bool(np.allclose(ours, episode)) for episode in theirs]
    print(f"{name}: TorchRL's first start {ours.round(3)[:4]}, theirs {[e.round(3)[:4].tolist() for e in theirs]}")
    print(f"{name}: equal to their first episode: {same[0]}, to their second: {same[1]}")
    assert same == [False, True], name


pendulum = gymnasium.make("Pendulum-v1")
compare("Pendulum-v1", [pendulum.reset(seed=0)[0], pendulum.reset()[0]], GymEnv("Pendulum-v1"), "observation")
walker = suite.load("walker", "walk", task_kwargs={"random": 0})
starts = [walker.reset().observation["orientations"] for _ in range(2)]
compare("walker/walk", starts, DMControlEnv("walker", "walk"), "orientations")
PY
