#!/usr/bin/env bash
# Expected: the critic that is given to TD3Loss is the first of its two critics; it may have been trained before, or
#   initialised with care.
# Instead: both critics are drawn anew, each parameter uniformly between the smallest and the largest number of the
#   given one: a pretrained critic becomes noise of the same size, biases that were 0 stay 0. Given as a list of two
#   modules, they are kept. DDPGLoss keeps the one it is given.
# Versions: torchrl 0.14.1, tensordict 0.14.3, torch 2.13.0.
# Matters for: warm starts, fine-tuning on another robot, orthogonal or zero-output initialisation.
# Source: the argument's documentation says "duplicated"; nothing was found on the values.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check torch==2.13.0 torchrl==0.14.1 tensordict==0.14.3 numpy==2.2.6
venv/bin/python - <<'PY'
import copy
from importlib.metadata import version

import torch
from tensordict import TensorDict
from torchrl.data import Bounded
from torchrl.modules import MLP, Actor, ValueOperator
from torchrl.objectives import DDPGLoss, TD3Loss

torch.manual_seed(0)
states, actions = torch.randn(1000, 4), torch.rand(1000, 2) * 2 - 1
batch = TensorDict(observation=states, action=actions, batch_size=[1000])
target = states.sum(-1, keepdim=True) - actions.square().sum(-1, keepdim=True)
critic = ValueOperator(MLP(in_features=6, out_features=1, num_cells=[64, 64]), in_keys=["observation", "action"])
optimiser = torch.optim.Adam(critic.parameters(), 3e-3)
for _ in range(500):
    loss = (critic(batch.copy())["state_action_value"] - target).square().mean()
    optimiser.zero_grad()
    loss.backward()
    optimiser.step()


def error(network, params):
    with torch.no_grad(), params.to_module(network):
        return float((network(batch.copy())["state_action_value"] - target).square().mean().sqrt())


print(*(f"{name} {version(name)}" for name in ("torchrl", "tensordict", "torch")))
spread, trained = float(target.std()), float(loss.detach().sqrt())
print(f"root mean square error of the trained critic {trained:.2f}; of the mean as a guess {spread:.2f}")
actor = Actor(torch.nn.Linear(4, 2))
spec = Bounded(-1, 1, (2,))
single = TD3Loss(actor, copy.deepcopy(critic), action_spec=spec)
listed = TD3Loss(actor, [copy.deepcopy(critic), copy.deepcopy(critic)], action_spec=spec)
ddpg = DDPGLoss(actor, copy.deepcopy(critic))
errors = {
    "TD3Loss given the critic": [error(single.qvalue_network, single.qvalue_network_params[i]) for i in range(2)],
    "TD3Loss given a list": [error(listed.qvalue_network, listed.qvalue_network_params[i]) for i in range(2)],
    "DDPGLoss given the critic": [error(ddpg.value_network, ddpg.value_network_params)],
}
for name, found in errors.items():
    print(f"{name}: {[round(value, 2) for value in found]}")
anew, kept, ddpgs = errors.values()
assert min(anew) > 0.9 * spread and max(kept) < 1.5 * trained and ddpgs[0] < 1.5 * trained
PY
