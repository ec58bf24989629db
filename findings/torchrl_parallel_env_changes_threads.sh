#!/usr/bin/env bash
# Expected: an environment with processes of its own leaves the number of PyTorch's threads in this process alone, or
#   gives back what it took when it is closed.
# Instead: when it starts, ParallelEnv takes one thread away for each worker; when it is closed, it adds as many as it
#   has workers, up to the number at import, whatever it took. torch.set_num_threads(1) before, with 4 workers on 8
#   cores: 1 while it runs, 5 afterwards.
# Versions: torchrl 0.14.1, tensordict 0.14.3, torch 2.13.0, gymnasium 1.3.0.
# Matters for: the learner's speed while robots are collected in processes; runs that are to be repeated to the bit,
#   as sums depend on the number of threads: what is computed after the environment was closed differs.
# Source: the documentation of num_threads has another default, the number of workers plus one.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check \
  torch==2.13.0 torchrl==0.14.1 tensordict==0.14.3 gymnasium==1.3.0 numpy==2.2.6
cat > threads.py <<'PY'
import warnings
from importlib.metadata import version

import torch

torch.set_num_threads(8)  # as on a machine of eight cores
from torchrl.envs import GymEnv, ParallelEnv  # noqa: E402

warnings.simplefilter("ignore")


def make():
    return GymEnv("Pendulum-v1")


def around(before):
    torch.set_num_threads(before)
    env = ParallelEnv(4, make, mp_start_method="spawn")
    env.reset()
    during = torch.get_num_threads()
    env.close()
    print(f"set {before}, while it runs {during}, after close {torch.get_num_threads()}", flush=True)
    return during, torch.get_num_threads()


if __name__ == "__main__":
    print(*(f"{name} {version(name)}" for name in ("torchrl", "torch")), "- threads:", torch.get_num_threads())
    assert around(1) == (1, 5)
    assert around(8) == (4, 8)
    assert around(2) == (1, 5)
PY
venv/bin/python threads.py
