#!/usr/bin/env bash
# Expected: cpprb's Nstep "replaces done with N-step version" and next_obs with that of N steps later, says its page: a
#   window of 3 steps with the fall in it is an end, and one that the time limit cuts goes on from the last observation.
# Instead: a window whose last step is the fall is no end: the value of the fallen robot is added to it. With N = 2 that
#   is one of the two windows that see the fall. The last N - 1 windows of an episode that ends by the time limit have
#   done = 0 and a next_obs of ones, which is no observation of any episode. on_episode_end() is called after each
#   episode, as it should be.
# Versions: cpprb 11.0.0, numpy 2.2.6.
# Matters for: walkers with n-step returns: the value of having fallen is learned from nothing, since no transition
#   starts there, and each time limit adds targets made up from a constant.
# Source: https://ymd_h.gitlab.io/cpprb/features/nstep/; no issue found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check cpprb==11.0.0 numpy==2.2.6
venv/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from cpprb import ReplayBuffer

GAMMA, STEPS = 0.5, 5
print(*(f"{name} {version(name)}" for name in ("cpprb", "numpy")), f"- gamma = {GAMMA}")


def stored(size, falls):
    """Return the rows (step, return, next observation, end) of two episodes of STEPS steps; a step is worth 1."""
    shapes = {"obs": {"shape": 2}, "act": {}, "rew": {}, "next_obs": {"shape": 2}, "done": {}}
    buffer = ReplayBuffer(64, shapes, Nstep={"size": size, "gamma": GAMMA, "rew": "rew", "next": "next_obs"})
    for step in range(2 * STEPS):
        last = step % STEPS == STEPS - 1
        here = np.array([100.0 + step, -step])
        buffer.add(obs=here, act=0, rew=-8 if last and falls else 1, next_obs=here + [1, -1], done=last and falls)
        if last:
            buffer.on_episode_end()
    rows = buffer.get_all_transitions()
    return [
        (int(obs[0]) - 100, float(reward), following.tolist(), bool(done))
        for obs, reward, following, done in zip(rows["obs"], rows["rew"][:, 0], rows["next_obs"], rows["done"][:, 0])
    ]


for size in (2, 3, 4):
    rows = stored(size, falls=True)
    print(f"N = {size}; the robot falls in step 4, which costs 8: step, return, next observation, end")
    for row in rows[:STEPS]:
        step, worth, _, end = row
        sees = step + size >= STEPS
        print("   ", *row, "<- the fall is in it" if sees and not end else "")
        assert end == (step + size > STEPS)  # ... == sees would be right
        assert worth == sum(GAMMA**k * (-8 if step + k == STEPS - 1 else 1) for k in range(min(size, STEPS - step)))
    assert rows[STEPS - size][2] == [100.0 + STEPS, -STEPS] and not rows[STEPS - size][3]

rows = stored(3, falls=False)
print("N = 3; the time limit comes after step 4: step, return, next observation, end")
for row in rows[:STEPS]:
    step, _, following, end = row
    print("   ", *row, "<- no observation" if following == [1, 1] else "")
    assert not end and following == ([1, 1] if step > STEPS - 3 else [100.0 + step + 3, -step - 3])
PY
