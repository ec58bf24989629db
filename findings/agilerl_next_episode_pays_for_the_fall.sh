#!/usr/bin/env bash
# Expected: AgileRL's MultiStepReplayBuffer adds up rewards until the episode ends ("Stop if episode terminated", says
#   its source), so that the step of a fall is stored with its own reward and as an end.
# Instead: the first step of a window is not asked whether it is the last of its episode. The step of the fall gets the
#   rewards of the next episode's first steps, the next episode's observation, and is no end: it is worth what a new
#   start is worth. Steps before it are stored as they should be. And with several environments an end in one of them
#   cuts the windows of all: they have fewer steps, which RainbowDQN's learn() still discounts by gamma ** n_step.
# Versions: agilerl 2.58.0, tensordict 0.13.0, torch 2.13.0.
# Matters for: tasks that end by falling, where the penalty is in the last step, and for parallel environments, where in
#   most windows somebody falls.
# Source: none found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check torch==2.13.0 tensordict==0.13.0 gymnasium==1.3.0 numpy==2.2.6 \
  accelerate==1.7.0 dill==0.3.9 lazy-loader==0.4 pydantic==2.11.7 google-cloud-storage==2.19.0
venv/bin/pip install -q --disable-pip-version-check --no-deps agilerl==2.58.0 agilerl-arena==1.29.0
venv/bin/python - <<'PY'
from importlib.metadata import version

import torch
from agilerl.components.replay_buffer import MultiStepReplayBuffer
from tensordict import TensorDict

N_STEP, GAMMA = 3, 0.5
print(*(f"{name} {version(name)}" for name in ("agilerl", "tensordict", "torch")), f"- n_step={N_STEP}, gamma={GAMMA}")


def stored(rewards, ends):
    """Return the buffer's rows (step, reward, step of the next observation, end), from one list per environment."""
    rewards, ends = (torch.tensor(table, dtype=torch.float).T[..., None] for table in (rewards, ends))
    buffer = MultiStepReplayBuffer(max_size=100, n_step=N_STEP, gamma=GAMMA)
    for step, (reward, end) in enumerate(zip(rewards, ends)):
        here = torch.full_like(reward, step)
        row = {"obs": here, "action": here, "reward": reward, "next_obs": here + 1, "done": end}
        buffer.add(TensorDict(row, batch_size=[len(reward)]))
    rows = buffer.storage[: len(buffer)]
    columns = (rows[key].flatten().tolist() for key in ("obs", "reward", "next_obs", "done"))
    return [(int(obs), reward, int(following), bool(end)) for obs, reward, following, end in zip(*columns)]


# The robot falls in step 2, which costs 8; from step 3 on, in the next episode, each step is worth 4.
FALLS = [0, 0, -8, 4, 4, 4], [0, 0, 1, 0, 0, 0]
# Another one, which never falls, gets 1 in each step.
WALKS = [1] * 6, [0] * 6
fallen = stored([FALLS[0]], [FALLS[1]])
print("one environment; step, return, next observation, end")
for row in fallen:
    print("  ", *row, "" if row[0] != 2 else "<- the fall; expected: 2 -8.0 3 True")
assert fallen[:2] == [(0, -2.0, 3, True), (1, -4.0, 3, True)]  # as it should be
assert fallen[2] == (2, -8 + 4 * GAMMA + 4 * GAMMA**2, 5, False)

alone = stored([WALKS[0]], [WALKS[1]])
beside = stored([FALLS[0], WALKS[0]], [FALLS[1], WALKS[1]])[1::2]
print("the robot that never falls, alone                  ", alone)
print("the same robot, beside the one that falls in step 2", beside)
for row in alone:
    assert row == (row[0], 1 + GAMMA + GAMMA**2, row[0] + N_STEP, False)
assert beside[1] == (1, 1 + GAMMA, 3, False) and beside[0] == alone[0] and beside[2:] == alone[2:]
PY
