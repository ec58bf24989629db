"""Control steps per second of every way to step the biped, side by side.

    python benchmarks/env_throughput.py [out=FILE.json] [rounds=5] [sizes=1,16,64,256,1024]

Bare: a Python loop of ``mj_step`` over 64 robots, one thread, nothing else. Full: the TorchRL environment that training
uses (float32, CatFrames, counters, resets). Actions are random and held for 5 steps.
"""

from __future__ import annotations

from collections.abc import Callable

import gymnasium
import mujoco
import numpy as np
import torch
from common import options, rates, report
from tensordict import TensorDictBase
from torchrl.envs import EnvBase

import gctd3
from gctd3.envs.factory import build_env
from gctd3.envs.settings import EnvSettings
from gctd3.tasks.walk import WalkingTask

ROBOTS, SUBSTEPS, HOLD = 64, 4, 5


def bare(robot: gctd3.Robot, steps: int) -> Callable[[], float]:
    """A loop of ``mj_step``: what stepping costs with nothing around it."""
    model = robot.model
    datas = [mujoco.MjData(model) for _ in range(ROBOTS)]
    low, high = robot.action_range.T
    rng = np.random.default_rng(0)

    def run() -> float:
        for data in datas:
            mujoco.mj_resetData(model, data)
        for step in range(steps):
            if step % HOLD == 0:
                control = rng.uniform(low, high, (ROBOTS, len(low)))
            for data, desired in zip(datas, control, strict=True):
                data.ctrl[:] = desired
                mujoco.mj_step(model, data, SUBSTEPS)
        return steps * ROBOTS

    return run


def torchrl(env: EnvBase, steps: int) -> Callable[[], float]:
    """A TorchRL environment with resets, as a collector steps it."""
    robots = env.batch_size.numel()
    state: list[TensorDictBase] = [env.reset()]

    def run() -> float:
        for step in range(steps):
            if step % HOLD == 0:
                action = torch.rand(*env.action_spec.shape) * 2 - 1
            _, state[0] = env.step_and_maybe_reset(state[0].set("action", action))
        return steps * robots

    return run


def vector(env: gymnasium.vector.VectorEnv, steps: int) -> Callable[[], float]:
    """A Gymnasium vector environment."""
    env.reset(seed=0)

    def run() -> float:
        for step in range(steps):
            if step % HOLD == 0:
                action = env.action_space.sample()
            env.step(action)
        return steps * env.num_envs

    return run


def main() -> None:
    """Measure, print, write."""
    given = options(out="", rounds="5", sizes="1,16,64,256,1024")
    torch.set_num_threads(1)
    robot = gctd3.Robot.from_mjcf("biped")
    task = WalkingTask(robot)
    work = {"bare mj_step loop, 64 robots, 1 thread": bare(robot, 40)}
    for threads in (1, 2):
        for size in (int(text) for text in given["sizes"].split(",")):
            settings = EnvSettings(num_envs=size, threads=threads)
            steps = max(20, min(200, 4096 // size))
            name = f"batched TorchRL env, {size} robots, {threads} thread{'s'[: threads - 1]}"
            work[name] = torchrl(build_env(task, settings, 0), steps)
    single = EnvSettings(backend="dm_control", num_envs=1)
    work["dm_control TorchRL env, 1 robot"] = torchrl(build_env(task, single, 0), 100)
    batch = gymnasium.make_vec("gctd3/Biped-v0", num_envs=ROBOTS, threads=1)
    work["Gymnasium vector env, 64 robots, 1 thread"] = vector(batch, 60)
    sync = gymnasium.make_vec("gctd3/Biped-v0", num_envs=16, vectorization_mode="sync")
    work["Gymnasium SyncVectorEnv of 16 single envs"] = vector(sync, 30)

    found = rates(work, int(given["rounds"]))
    base, slow = found["bare mj_step loop, 64 robots, 1 thread"], found["dm_control TorchRL env, 1 robot"]
    print(f"{'':52}{'steps/s':>10}{'of bare':>10}{'x dm_control':>14}")
    for name, rate in found.items():
        print(f"{name:52}{rate:>10,.0f}{rate / base:>10.2f}{rate / slow:>14.1f}")
    report("env_throughput", {"unit": "control steps per second, median", "rates": found}, given["out"])


if __name__ == "__main__":
    main()
