#!/usr/bin/env bash
# Expected: skrl's PPO with its default, time_limit_bootstrap=False, takes an episode's end at the time limit for a
#   fall: nothing of what comes after it counts.
# Instead: with the default the time limit is no end at all: the next value that is used is that of the next episode's
#   start, and advantages run on from episode to episode. A reward of 100 in the second episode is a return of 100 in
#   the first, whose robot had no part in it. With time_limit_bootstrap=True episodes are kept apart.
# Versions: skrl 2.1.1, torch 2.13.0, gymnasium 1.3.0.
# Matters for: walking tasks, whose good episodes all end at the time limit.
# Source: Toni-SM/skrl issues 449 and 224, both closed.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check skrl==2.1.1 torch==2.13.0 gymnasium==1.3.0 numpy==2.2.6
venv/bin/python - <<'PY'
from importlib.metadata import version

import torch
from skrl.agents.torch.ppo import PPO_CFG
from skrl.agents.torch.ppo.ppo import compute_gae

print(*(f"{name} {version(name)}" for name in ("skrl", "torch")), "- default:", PPO_CFG().time_limit_bootstrap)
# Four steps of one environment: two episodes of two steps each; the critic knows nothing yet.
reward = torch.tensor([0.0, 0.0, 0.0, 100.0])[:, None]
values = torch.zeros(4, 1)
end = torch.tensor([False, True, False, True])[:, None]
never = torch.zeros_like(end)


def returns(terminated, truncated, bootstrap):
    found, _ = compute_gae(
        rewards=reward,
        terminated=terminated,
        truncated=truncated,
        values=values,
        last_values=values[0],
        discount_factor=1.0,
        lambda_coefficient=1.0,
        time_limit_bootstrap=bootstrap,
    )
    return found.flatten().tolist()


fallen = returns(end, never, False)
limit = returns(never, end, False)
bootstrapped = returns(never, end, True)
print("rewards                                         ", reward.flatten().tolist())
print("returns, both episodes end by a fall            ", fallen)
print("returns, both end at the time limit, the default", limit)
print("the same with time_limit_bootstrap=True         ", bootstrapped)
assert PPO_CFG().time_limit_bootstrap is False
assert fallen == bootstrapped == [0.0, 0.0, 100.0, 100.0] and limit == [100.0] * 4
PY
