"""Control steps per second on terrain against the plane, with a height scan and without, as ratios.

    python benchmarks/terrain_cost.py [out=FILE.json] [rounds=9] [robots=biped,quadruped] [size=64] [threads=1]
        [steps=40]

The TorchRL environment that training uses (float32, CatFrames, counters, resets), on one model for all robots. Actions
are random and held for 5 steps. Rounds take the grounds in turn, so that a drift of the machine hits all alike; a ratio
is that of medians.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from common import options, rates, report
from tensordict import TensorDictBase

from gctd3.envs.factory import build_env
from gctd3.envs.settings import EnvSettings
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.height_scan import HeightScan
from gctd3.tasks.terrain import Terrain, TerrainKind
from gctd3.tasks.terrain_kinds import Boxes, FlatGround, Gaps, RoughGround, Slopes, Stairs, SteppingStones
from gctd3.tasks.walk import WalkSettings

OWN = {"out": "", "rounds": "9", "robots": "biped,quadruped", "size": "64", "threads": "1", "steps": "40"}
HOLD = 5
KINDS: dict[str, TerrainKind] = {
    "flat": FlatGround(),
    "rough": RoughGround(),
    "slopes": Slopes(),
    "stairs": Stairs(),
    "boxes": Boxes(),
    "gaps": Gaps(),
    "stones": SteppingStones(),
}
PLANE, ALL = "plane", "all kinds"


def stepping(robot: str, terrain: Terrain | None, scan: bool, given: dict[str, str]) -> Callable[[], float]:
    """A TorchRL environment with resets, as a collector steps it."""
    base = WalkSettings()
    features = {**base.features, "scan": HeightScan()} if scan else base.features
    task = replace(base, terrain=terrain, features=features).build(RobotSettings(robot))
    settings = EnvSettings(num_envs=int(given["size"]), threads=int(given["threads"]))
    env, steps = build_env(task, settings, 0), int(given["steps"])
    state: list[TensorDictBase] = [env.reset()]

    def run() -> float:
        for step in range(steps):
            if step % HOLD == 0:
                action = torch.rand(*env.action_spec.shape) * 2 - 1
            _, state[0] = env.step_and_maybe_reset(state[0].set("action", action))
        return float(steps * settings.num_envs)

    return run


def measure(robot: str, given: dict[str, str]) -> dict[str, dict[str, float]]:
    """Return the steps per second of a robot on each ground, and their ratios to those on the plane."""
    grounds: dict[str, Terrain | None] = {PLANE: None}
    grounds |= {name: Terrain(kinds={name: kind}) for name, kind in KINDS.items()}
    grounds[ALL] = Terrain(kinds=KINDS)
    work = {}
    for name, terrain in grounds.items():
        work[name] = stepping(robot, terrain, False, given)
        if name in (PLANE, ALL):
            work[f"{name}, with a scan"] = stepping(robot, terrain, True, given)
    seen = rates(work, int(given["rounds"]))
    return {name: {"steps_per_s": rate, "ratio": rate / seen[PLANE]} for name, rate in seen.items()}


def main() -> None:
    """Measure, print, write."""
    given = options(**OWN)
    torch.set_num_threads(1)
    figures = {}
    for robot in given["robots"].split(","):
        figures[robot] = measure(robot, given)
        print(f"\n{robot:24}{'steps/s':>10}{'to the plane':>14}")
        for name, row in figures[robot].items():
            print(f"{name:24}{row['steps_per_s']:>10,.0f}{row['ratio']:>14.2f}", flush=True)
    report(
        "terrain_cost", {"settings": {k: v for k, v in given.items() if k != "out"}, "robots": figures}, given["out"]
    )


if __name__ == "__main__":
    main()
