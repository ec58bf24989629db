"""Our td3, sac and ddpg beside Stable-Baselines3's: same tasks, observations, hyperparameters, evaluator and starts.

    python benchmarks/yardsticks.py out=FILE.json plot=FILE.png
    python benchmarks/yardsticks.py tasks=halfcheetah algos=td3 seeds=0 steps=30000 every=5000 out=FILE.json

Trains an MLP on Gymnasium's own observation with the values of ``benchmarks/yardstick_recipe.py``; ours is
``python -m gctd3.train task=... task.observation=flat``, theirs a model of Stable-Baselines3's. Both are evaluated
every ``every`` steps over ``episodes`` episodes by :func:`.rollout.evaluate`, from the same starts. Trainings run one
after another, seed by seed. Each is written to ``out`` as soon as it is over; those that ``out`` holds are not made
again, so that the same command goes on after it was stopped. On two cores: one command for each task, each with its own
``out``.
"""

from __future__ import annotations

import itertools
import json
import shutil
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path

import torch
from common import commit, options, report
from gait_table import read_progress
from hydra import compose, initialize_config_module
from peers import ENDLESS, Evaluator, versions
from yardstick_curves import SIDES, Run, compare, draw, figures, table
from yardstick_recipe import ALGORITHMS, TASKS, Recipe, ours, theirs

from gctd3.config.build import build
from gctd3.config.command_line import CONF
from gctd3.training.run_log import PROGRESS
from gctd3.training.saved_configuration import CONFIG
from gctd3.training.settings import TrainSettings

# Which results belong together.
KEPT = ("steps", "every", "episodes", "random_steps")


def command_line(run: Run, recipe: Recipe, given: dict[str, str]) -> list[str]:
    """Our training's, but for where it writes."""
    long = [f"total_frames={given['steps']}", f"evaluation.every={given['every']}"]
    evaluated = [f"evaluation.episodes={given['episodes']}", f"seed={run.seed}"]
    return [*ours(run.algo, run.task, recipe), *long, *evaluated, f"threads={given['threads']}", "logger=none"]


def settings_of(run: Run, recipe: Recipe, given: dict[str, str]) -> TrainSettings:
    """Our training's settings: theirs has the same task and the same evaluator."""
    with initialize_config_module(CONF, version_base="1.3"):
        return build(compose("config", command_line(run, recipe, given)))


def train_ours(run: Run, recipe: Recipe, given: dict[str, str], directory: Path) -> None:
    """Train with the command that everybody uses, or continue it."""
    resume = (directory / CONFIG).is_file()
    line = [f"resume={directory}"] if resume else [*command_line(run, recipe, given), f"hydra.run.dir={directory}"]
    directory.mkdir(parents=True, exist_ok=True)
    with (directory / "log.txt").open("a") as log:
        module = [sys.executable, "-m", "gctd3.train"]
        subprocess.run([*module, *line], check=True, stdout=log, stderr=subprocess.STDOUT)


def train_theirs(run: Run, recipe: Recipe, given: dict[str, str], directory: Path) -> None:
    """Train Stable-Baselines3's, from the beginning."""
    from stable_baselines3.common.callbacks import BaseCallback

    shutil.rmtree(directory, ignore_errors=True)
    torch.set_num_threads(int(given["threads"]))
    evaluator = Evaluator(settings_of(run, recipe, given), directory, ENDLESS, int(given["threads"]))
    model = theirs(run.algo, run.task, recipe, run.seed)

    class EvaluationCallback(BaseCallback):
        def _on_step(self) -> bool:
            evaluator(act, self.num_timesteps, self.model._n_updates)
            return True

    def act(observation: torch.Tensor) -> torch.Tensor:
        return torch.as_tensor(model.predict(observation.numpy(), deterministic=True)[0])

    model.learn(int(given["steps"]), callback=EvaluationCallback())


def known(out: str, given: dict[str, str]) -> list[Run]:
    """The runs that ``out`` holds.

    Raises:
        SystemExit: If they were made with other options.
    """
    if not out or not Path(out).exists():
        return []
    held = json.loads(Path(out).read_text(encoding="utf-8"))
    other = [f"{key}={held['options'][key]}" for key in KEPT if held["options"][key] != given[key]]
    if other:
        raise SystemExit(f"{out} holds runs with {', '.join(other)}: choose another out=, or the same options")
    return [Run(**run) for run in held["runs"]]


def plan(given: dict[str, str]) -> list[Run]:
    """All runs that are asked for, seed by seed.

    Raises:
        SystemExit: If there is no such task, algorithm or side, or no evaluation.
    """
    chosen = {key: given[key].split(",") for key in ("tasks", "algos", "sides")}
    for key, accepted in (("tasks", TASKS), ("algos", ALGORITHMS), ("sides", SIDES)):
        unknown = [name for name in chosen[key] if name not in accepted]
        if unknown:
            raise SystemExit(f"{key} knows no {', '.join(unknown)}; there are {', '.join(accepted)}")
    if int(given["every"]) > int(given["steps"]):
        raise SystemExit(
            f"every must be at most steps={given['steps']}, got {given['every']}: nobody would be evaluated"
        )
    seeds = [int(text) for text in given["seeds"].split(",")]
    names = itertools.product(seeds, chosen["tasks"], chosen["algos"], chosen["sides"])
    return [Run(task, algo, side, seed) for seed, task, algo, side in names]


def main() -> None:
    """Train what is missing, compare."""
    given = options(
        tasks=",".join(TASKS),
        algos=",".join(ALGORITHMS),
        sides=",".join(SIDES),
        seeds="0,1,2",
        steps="100000",
        every="10000",
        episodes="5",
        random_steps=str(Recipe().random_steps),
        threads="1",
        runs="runs/yardsticks",
        out="",
        plot="",
    )
    recipe = replace(Recipe(), random_steps=int(given["random_steps"]))
    over = known(given["out"], given)
    missing = [run for run in plan(given) if run.name not in [other.name for other in over]]
    for run in missing:
        directory = Path(given["runs"]).absolute() / run.task / run.algo / f"{run.side}-seed{run.seed}"
        print(f"{run.task} {run.algo} {run.side} seed {run.seed}", flush=True)
        run.commit = commit()
        train = train_ours if run.side == "gctd3" else train_theirs
        train(run, recipe, given, directory)
        run.curve = read_progress(directory / PROGRESS)
        run.minutes = run.curve[-1]["wall_s"] / 60
        over.append(run)
        write(over, recipe, given)
    if not missing:
        write(over, recipe, given)


def write(runs: list[Run], recipe: Recipe, given: dict[str, str]) -> None:
    """Print and keep what is known so far."""
    found = [compare(runs, task, algo) for task, algo in itertools.product(TASKS, ALGORITHMS)]
    comparisons = [comparison for comparison in found if comparison is not None]
    if comparisons:
        print(f"\n{table(comparisons)}", flush=True)
    if comparisons and given["plot"]:
        draw(comparisons, Path(given["plot"]))
    content = {
        "options": {key: given[key] for key in KEPT},
        "recipe": asdict(recipe),
        "versions": versions("sb3"),
        "comparisons": figures(comparisons),
        "runs": [asdict(run) for run in runs],
    }
    report("yardsticks", content, given["out"])


if __name__ == "__main__":
    main()
