#!/usr/bin/env bash
# Expected: get_minari of d3rlpy returns a dataset in which each action stands beside the observation that it was taken
#   in, as in the Minari dataset.
# Instead: a Minari episode has one observation more than actions, the last one. get_minari puts the episodes end to
#   end, with their last observations, and cuts all by the flags, which are as many as the actions. The second episode
#   then begins with the first one's last observation, the third with the second's last two, the 501st 500 steps early:
#   no action but the first episode's is with its observation, and transitions run from the end of one episode to the
#   start of the next. Returns are right, and there is no warning.
# Versions: d3rlpy 2.8.1, minari 0.5.4, gymnasium 1.0.0 (d3rlpy's), torch 2.13.0.
# Matters for: offline learning, and comparisons of its algorithms, on Minari's data: cloning the behaviour of a policy
#   without noise already fails.
# Source: none found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check \
  d3rlpy==2.8.1 minari==0.5.4 gymnasium==1.0.0 h5py==3.16.0 pillow==12.0.0 torch==2.13.0 numpy==2.2.6
export MINARI_DATASETS_PATH="$PWD/data"
venv/bin/python -W ignore - <<'PY'
import logging
from importlib.metadata import version

import gymnasium
import minari
import numpy as np
import structlog
from d3rlpy.datasets import get_minari
from minari.data_collector import EpisodeBuffer

structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.WARNING))
EPISODES, STEPS = 40, 20


def policy(observations):
    return -1.5 * observations[..., 2:] + 0.2


env = gymnasium.make("Pendulum-v1", max_episode_steps=STEPS)
buffers = []
for episode in range(EPISODES):
    observations, steps = [env.reset(seed=episode)[0]], []
    for _ in range(STEPS):
        action = policy(observations[-1]).astype(np.float32)
        observation, *step, _ = env.step(action)
        observations.append(observation)
        steps.append((action, *step))
    actions, rewards, terminations, truncations = zip(*steps)
    assert truncations[-1] and not any(terminations)
    buffers.append(
        EpisodeBuffer(
            observations=observations,
            actions=list(actions),
            rewards=list(rewards),
            terminations=list(terminations),
            truncations=list(truncations),
        )
    )
written = list(minari.create_dataset_from_buffers("findings/pendulum-v0", buffers, env=env).iterate_episodes())
read = get_minari("findings/pendulum-v0")[0].episodes
print(*(f"{name} {version(name)}" for name in ("d3rlpy", "minari", "gymnasium", "torch")))
assert len(written) == len(read) == EPISODES
everything = np.concatenate([episode.observations for episode in written])
for k, (ours, theirs) in enumerate(zip(written, read)):
    assert np.array_equal(ours.actions, theirs.actions) and np.allclose(ours.rewards, theirs.rewards[:, 0])
    assert np.array_equal(theirs.observations, everything[k * STEPS : (k + 1) * STEPS])
    right = [
        np.isclose(policy(observations), actions, atol=1e-5).mean()
        for observations, actions in ((ours.observations[:-1], ours.actions), (theirs.observations, theirs.actions))
    ]
    if k in (0, 1, 2, 20, EPISODES - 1):
        source, step = divmod(k * STEPS, STEPS + 1)
        print(f"episode {k}: actions that are the policy's for their observation {right[0]:.0%} in Minari", end=", ")
        print(f"{right[1]:.0%} in d3rlpy; its first observation is number {step} of episode {source}")
    assert right == [1, k == 0]
PY
