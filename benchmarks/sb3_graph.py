"""``GraphExtractor`` beside Stable-Baselines3's MLP: one algorithm, one robot, the same nodes observed.

    python benchmarks/sb3_graph.py out=FILE.json
    python benchmarks/sb3_graph.py env=HalfCheetah-v5 algo=td3 seeds=0,1,2,3,4 frames=200000 every=20000 out=FILE.json

Both sides have Stable-Baselines3's defaults, its fully connected layers too, and the same observation: positions and
velocities of the nodes in two frames. They differ in the features extractor: ``graph`` encodes the nodes by graph
convolutions, ``mlp`` is Stable-Baselines3's own for a ``Dict``, which puts them side by side. Every ``every`` frames
the deterministic policy is evaluated over ``episodes`` episodes, from the same starts. Trainings run one after another,
seed by seed. Each is written to ``out`` as soon as it is over; those that ``out`` holds are not made again, so that the
same command goes on after it was stopped.
"""

from __future__ import annotations

import itertools
import json
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import stable_baselines3
import torch
from common import commit, options, report
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.noise import NormalActionNoise
from yardstick_curves import difference, mean

from gctd3.sb3 import GraphExtractor, NodeObservation

SIDES = ("graph", "mlp")
ALGORITHMS = ("td3", "sac", "ppo")
HISTORY = 2
ACTION_NOISE = 0.1  # standard deviation of TD3's exploration, its authors'; Stable-Baselines3's default is none
FIRST_START = 10_000  # seed of the evaluations' starts, far from those of the trainings
# Which results belong together.
KEPT = ("env", "algo", "frames", "every", "episodes")


@dataclass
class Run:
    """One training.

    Attributes:
        side: Whose features extractor.
        seed: Seed of the training.
        commit: Commit of this project when it was started.
        minutes: Wall-clock from the first frame to the last evaluation.
        parameters: Trained numbers in the whole policy, actor and critics.
        frames: Frames at each evaluation.
        returns: Mean return at each evaluation.
    """

    side: str
    seed: int
    commit: str = ""
    minutes: float = 0.0
    parameters: int = 0
    frames: list[int] = field(default_factory=list)
    returns: list[float] = field(default_factory=list)


def make(name: str) -> NodeObservation:
    """The robot, its nodes observed."""
    return NodeObservation(gymnasium.make(name), history=HISTORY)


def model_of(side: str, algo: str, env: NodeObservation, seed: int) -> BaseAlgorithm:
    """Stable-Baselines3's algorithm with one of the two features extractors, on the CPU."""
    policy: dict[str, Any] = {}
    if side == "graph":
        policy = {"features_extractor_class": GraphExtractor, "features_extractor_kwargs": {"graph": env.graph}}
    more = {}
    if algo == "td3":
        zero = np.zeros(env.action_space.shape)
        more["action_noise"] = NormalActionNoise(mean=zero, sigma=zero + ACTION_NOISE)
    kind = getattr(stable_baselines3, algo.upper())
    return kind("MultiInputPolicy", env, policy_kwargs=policy, seed=seed, device="cpu", **more)


class Evaluation(BaseCallback):
    """Evaluate the deterministic policy every so many frames.

    Args:
        run: What to write the evaluations to.
        env: Environment of its own.
        every: Frames between evaluations.
        episodes: Episodes of each.
    """

    def __init__(self, run: Run, env: gymnasium.Env, every: int, episodes: int) -> None:
        super().__init__()
        self.run, self.env, self.every, self.episodes = run, Monitor(env), every, episodes

    def _on_step(self) -> bool:
        if self.num_timesteps % self.every == 0:
            self.env.reset(seed=FIRST_START)
            value, _ = evaluate_policy(self.model, self.env, n_eval_episodes=self.episodes, deterministic=True)
            self.run.frames.append(self.num_timesteps)
            self.run.returns.append(round(float(value), 2))
            print(f"  {self.num_timesteps:>8,}  {value:.0f}", flush=True)
        return True


def train(run: Run, given: dict[str, str]) -> None:
    """Train and evaluate one policy."""
    torch.set_num_threads(int(given["threads"]))
    model = model_of(run.side, given["algo"], make(given["env"]), run.seed)
    run.parameters = sum(p.numel() for p in model.policy.parameters() if p.requires_grad)
    began = time.perf_counter()
    model.learn(int(given["frames"]), Evaluation(run, make(given["env"]), int(given["every"]), int(given["episodes"])))
    run.minutes = round((time.perf_counter() - began) / 60, 2)


def known(given: dict[str, str]) -> list[Run]:
    """The runs that ``out`` holds.

    Raises:
        SystemExit: If they were made with other options.
    """
    out = given["out"]
    if not out or not Path(out).exists():
        return []
    held = json.loads(Path(out).read_text(encoding="utf-8"))
    other = [f"{key}={held['options'][key]}" for key in KEPT if held["options"][key] != given[key]]
    if other:
        raise SystemExit(f"{out} holds runs with {', '.join(other)}: choose another out=, or the same options")
    return [Run(**run) for run in held["runs"]]


def compared(runs: list[Run]) -> dict[str, object]:
    """Means over seeds with Student's 95 % intervals, and graph minus mlp with Welch's, of the last evaluation."""
    last = {side: [run.returns[-1] for run in runs if run.side == side] for side in SIDES}
    whole = {side: [float(np.mean(run.returns)) for run in runs if run.side == side] for side in SIDES}
    if not all(last.values()):
        return {}
    found: dict[str, object] = {}
    for name, values in (("last evaluation", last), ("all evaluations", whole)):
        found[name] = {side: asdict(mean(values[side])) for side in SIDES}
        found[name] |= {"difference": asdict(difference(*(values[side] for side in SIDES)))}  # type: ignore[operator]
        print(f"{name}: {', '.join(f'{side} {mean(values[side]).text()}' for side in SIDES)}; difference "
              f"{difference(*(values[side] for side in SIDES)).text()}")  # fmt: skip
    return found


def main() -> None:
    """Train what is missing, compare."""
    given = options(
        env="Hopper-v5",
        algo="ppo",
        sides=",".join(SIDES),
        seeds="0,1,2",
        frames="20480",
        every="4096",
        episodes="10",
        threads="1",
        out="",
    )
    if given["algo"] not in ALGORITHMS:
        raise SystemExit(f"algo must be one of {', '.join(ALGORITHMS)}, got {given['algo']}")
    if unknown := set(given["sides"].split(",")) - set(SIDES):
        raise SystemExit(f"sides knows no {', '.join(sorted(unknown))}; there are {', '.join(SIDES)}")
    if not 0 < int(given["every"]) <= int(given["frames"]):
        raise SystemExit(f"every must be at least 1 and at most frames={given['frames']}, got {given['every']}")
    over = known(given)
    made = {(run.side, run.seed) for run in over}
    asked = itertools.product(map(int, given["seeds"].split(",")), given["sides"].split(","))
    missing = [(seed, side) for seed, side in asked if (side, seed) not in made]
    for seed, side in missing:
        print(f"{given['env']} {given['algo']} {side} seed {seed}", flush=True)
        run = Run(side, seed, commit())
        train(run, given)
        over.append(run)
        write(over, given)
    if not missing:
        write(over, given)


def write(runs: list[Run], given: dict[str, str]) -> None:
    """Print and keep what is known so far."""
    content: dict[str, object] = {
        "options": {key: given[key] for key in KEPT},
        "history": HISTORY,
        "action_noise": ACTION_NOISE if given["algo"] == "td3" else None,
        "versions": {"stable-baselines3": stable_baselines3.__version__, "torch": torch.__version__},
        "comparison": compared(runs),
        "runs": [asdict(run) for run in runs],
    }
    report("sb3_graph", content, given["out"])


if __name__ == "__main__":
    main()
