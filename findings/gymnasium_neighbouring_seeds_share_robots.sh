#!/usr/bin/env bash
# Expected: a run with seed 0 and one with seed 1 are two independent samples; that is what means and intervals over
#   seeds assume.
# Instead: a vector environment that is reset with seed s gives its i-th environment s + i. Of 8 environments seven are
#   the same in the runs with seeds 0 and 1, with equal starts and equal random numbers for the whole run; of 4,096
#   environments all but one.
# Versions: gymnasium 1.3.0.
# Matters for: results over seeds 0, 1, 2, ... of vectorised training. Seeds far apart, or a list of seeds, avoid it.
# Source: VectorEnv.reset documents seed + i; the consequence for neighbouring seeds is not spelt out there.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check gymnasium==1.3.0 numpy==2.2.6
venv/bin/python - <<'PY'
import gymnasium
import numpy as np

ROBOTS = 8


def episodes(seed):
    """The first three starts of each environment, shape [robots, 3 * observation]."""
    envs = gymnasium.make_vec("Pendulum-v1", num_envs=ROBOTS, vectorization_mode="sync")
    starts = [envs.reset(seed=seed)[0], envs.reset()[0], envs.reset()[0]]
    return np.concatenate(starts, axis=-1)


print("gymnasium", gymnasium.__version__)
first = episodes(0)
shared = {}
for seed in (1, 2, 1000):
    other = episodes(seed)
    shared[seed] = sum(bool((other == episode).all(-1).any()) for episode in first)
    print(f"of {ROBOTS} environments of seed 0 there are among those of seed {seed}, for three episodes: {shared[seed]}")
assert shared == {1: ROBOTS - 1, 2: ROBOTS - 2, 1000: 0}
PY
