"""Control steps per second of other libraries' tasks: ours beside the same put together of TorchRL's own parts.

    python benchmarks/library_throughput.py [out=FILE.json] [rounds=5] [sizes=1,8]

Both give the same numbers (``tests/envs/test_library_robots.py``): nodes, two frames of them, resets. Actions are
random.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from common import options, rates, report
from tensordict import TensorDictBase
from torchrl.envs import (
    CatFrames,
    CatTensors,
    Compose,
    DoubleToFloat,
    EnvBase,
    InitTracker,
    SerialEnv,
    StepCounter,
    TransformedEnv,
    UnsqueezeTransform,
)

from gctd3.envs.factory import build_env
from gctd3.envs.library import make_robot
from gctd3.envs.library_robots import observed
from gctd3.envs.nodes import with_nodes
from gctd3.envs.settings import EnvSettings, Library, LibrarySettings
from gctd3.robots.settings import RobotSettings

TASKS: dict[str, Library] = {
    "HalfCheetah-v5": "gymnasium",
    "Walker2d-v5": "gymnasium",
    "Ant-v5": "gymnasium",
    "walker-walk": "dm_control",
}


def stock(settings: LibrarySettings, robots: int) -> EnvBase:
    """The task on some robots of TorchRL's own parts; the task's own observation is ``"flat"``."""

    def one() -> EnvBase:
        env = make_robot(settings.library, settings.name)
        own = observed(env)
        noded = with_nodes(env, static=settings.static)
        if numbers := [key for key in own if not env.observation_spec[key].shape]:
            noded.append_transform(UnsqueezeTransform(-1, in_keys=numbers))
        noded.append_transform(CatTensors(own, "flat", sort=False, dim=-1))
        return noded

    stack = CatFrames(N=settings.history, dim=-1, in_keys=["nodes"], padding="same")
    env = SerialEnv(robots, one)
    return TransformedEnv(env, Compose(DoubleToFloat(), InitTracker(), StepCounter(), stack))


def stepped(env: EnvBase, steps: int) -> Callable[[], float]:
    """Steps an environment as a collector does."""
    state: list[TensorDictBase] = [env.reset()]
    shape = env.action_spec.shape

    def run() -> float:
        for _ in range(steps):
            action = 2 * torch.rand(*shape) - 1
            _, state[0] = env.step_and_maybe_reset(state[0].set("action", action))
        return steps * shape[0]

    return run


def main() -> None:
    """Measure, print, write."""
    given = options(out="", rounds="5", sizes="1,8")
    torch.set_num_threads(1)
    sizes = [int(text) for text in given["sizes"].split(",")]
    work = {}
    for name, library in TASKS.items():
        settings = LibrarySettings(library=library, name=name)
        task = settings.build(RobotSettings())
        for size in sizes:
            ours = build_env(task, EnvSettings("library", num_envs=size), 0)
            work[f"{name}, {size}, ours"] = stepped(ours, 400 // size)
            work[f"{name}, {size}, TorchRL"] = stepped(stock(settings, size), 400 // size)
    found = rates(work, int(given["rounds"]))
    print(f"{'task, robots':24}{'TorchRL, steps/s':>18}{'ours, steps/s':>16}{'ratio':>8}")
    for name, rate in found.items():
        if name.endswith("TorchRL"):
            case = name.removesuffix(", TorchRL")
            quick = found[f"{case}, ours"]
            print(f"{case:24}{rate:>18,.0f}{quick:>16,.0f}{quick / rate:>8.2f}")
    report("library_throughput", {"unit": "control steps per second, median", "rates": found}, given["out"])


if __name__ == "__main__":
    main()
