#!/usr/bin/env bash
# Expected: SBX's PPO with target_kl, which adapts the learning rate to the KL divergence, goes on after save() and
#   load() with the learning rate that it had. It is in the file twice: in the optimizer's state and in the schedule's.
# Instead: load() makes the schedule anew, with the rate that PPO was constructed with. The optimizer has the right one,
#   but the first update overwrites it. Here training has lowered it to 0.00001, and a resumed run starts with 0.0015.
# Versions: sbx-rl 0.28.0, stable-baselines3 2.9.2, jax 0.10.2, flax 0.12.8, optax 0.2.8, gymnasium 1.3.0.
# Matters for: trainings that are continued: in the first pass over the data, the policy leaves the saved one by several
#   times the KL divergence that was asked for.
# Source: none found of SBX; leggedrobotics/rsl_rl issue 221 is the same in rsl_rl, corrected there.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check sbx-rl==0.28.0 stable-baselines3==2.9.2 torch==2.13.0 jax==0.10.2 \
  flax==0.12.8 optax==0.2.8 gymnasium==1.3.0 numpy==2.2.6
JAX_PLATFORMS=cpu venv/bin/python - <<'PY'
from importlib.metadata import version

import gymnasium
import numpy as np
from sbx import PPO
from stable_baselines3.common.save_util import load_from_zip_file

STEPS = 1024
print(*(f"{name} {version(name)}" for name in ("sbx-rl", "stable-baselines3", "jax")))
trained = PPO("MlpPolicy", "Pendulum-v1", learning_rate=1e-3, target_kl=0.01, n_steps=STEPS, batch_size=64, seed=0)
trained.learn(3 * STEPS)
trained.save("trained.zip")
saved = load_from_zip_file("trained.zip")[0]


def rate(policy):
    return float(policy.actor_state.opt_state[1].hyperparams["learning_rate"])


def resume(schedule=None):
    """Load and train for an iteration; return the rates loaded, those used, and the first pass's largest divergence."""
    model = PPO.load("trained.zip", env=gymnasium.make("Pendulum-v1"))
    loaded, rates, divergences = (rate(model.policy), float(model.adaptive_lr.current_adaptive_lr)), [], []
    if schedule is not None:
        model.adaptive_lr = schedule
    adapt = model.adaptive_lr.update

    def record(divergence):
        adapt(divergence)
        divergences.append(divergence)
        rates.append(float(model.adaptive_lr.current_adaptive_lr))

    model.adaptive_lr.update = record
    model.learn(STEPS, reset_num_timesteps=False)
    batches = STEPS // model.batch_size  # of one pass over the data
    return loaded, np.array(rates), max(divergences[:batches])


print(f"saved:  optimizer {rate(saved['policy']):.6f}, schedule {saved['adaptive_lr'].current_adaptive_lr:.6f}")
(optimizer, schedule), rates, divergence = resume()
_, kept, kept_divergence = resume(saved["adaptive_lr"])
print(f"loaded: optimizer {optimizer:.6f}, schedule {schedule:.6f}")
print("learning rates after loading, and the largest KL divergence in the first pass, of which 0.01 is asked")
print(f"   as loaded                        {rates[:4].round(6)} ... {divergence:.3f}")
print(f"   with the schedule that was saved {kept[:4].round(6)} ... {kept_divergence:.3f}")
assert np.isclose(rate(saved["policy"]), 1e-5) and np.isclose(trained.adaptive_lr.current_adaptive_lr, 1e-5)
assert np.isclose(optimizer, 1e-5) and np.isclose(schedule, 1e-3)
assert rates[0] > 5e-4 and kept[0] < 2e-5 and divergence > 2 * kept_divergence
PY
