"""Do robots learn to follow commanded velocities? Trains each robot and seed, and tests it with a grid of commands.

    python benchmarks/velocity.py robots=go2 seeds=0,1,2 threads=2
    python benchmarks/velocity.py robots=go2 seeds=0 settings='algo=td3 total_frames=400_000'
    python benchmarks/velocity.py what=table

Each robot and seed is a file below ``out``: the errors and the falls under every command, and those of 200 episodes
whose commands are drawn anew, as in the training and, beside it, with commands that jump (``jumping``). It goes on
where it stopped: what has a file is left alone, and a training that was interrupted is continued. A training or an
evaluation that fails has a file too, with its last line, and counts as a failure; ``again=failed`` or ``again=all``
does it once more. A command counts as followed if no robot fell under it, and the mean velocity was within 0.15 m/s and
0.2 rad/s of it.
"""

from __future__ import annotations

import json
import os
import shlex
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from common import commit, options

from gctd3.envs.factory import build_env
from gctd3.evaluation.rollout import evaluate
from gctd3.files import title, write_text
from gctd3.runs.load import load_run
from gctd3.runs.settings import EvaluateSettings
from gctd3.tasks.velocity_command import NAME

RESULTS = Path(__file__).parent / "results" / "velocity"
EPISODES, STARTS = 200, 4
GRID = ("grid.forward=5", "grid.side=3", "grid.turn=3", f"grid.starts={STARTS}")  # 45 commands, and standing
CHECKPOINTS, TRAINED = "checkpoints", "trained"  # in the folder of a run; the second marks a finished training


def cell(
    robot: str, seed: int, folder: Path, threads: int, settings: Sequence[str], grid: Sequence[str]
) -> dict[str, Any]:
    """Train a robot with a seed, or continue its training, and test its best policy."""
    row: dict[str, Any] = {"robot": robot, "seed": seed, "settings": list(settings), "commit": commit()}
    goes_on = any((folder / CHECKPOINTS).glob("step-*"))
    if not goes_on:
        # What stopped before its first checkpoint.
        shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True, exist_ok=True)
    environment = {**os.environ, **{f"{name}_NUM_THREADS": str(threads) for name in ("OMP", "MKL", "OPENBLAS")}}
    log = folder.with_suffix(".txt")

    def call(command: str, *arguments: str) -> str | None:
        """Run a command, and return its last line if it fails."""
        line = [sys.executable, "-m", f"gctd3.{command}", *arguments]
        with log.open("a") as file:
            done = subprocess.run(line, stdout=file, stderr=subprocess.STDOUT, env=environment, check=False)
        said = [text for text in log.read_text().splitlines() if text.strip()]
        return None if done.returncode == 0 else f"exit code {done.returncode}: {said[-1] if said else 'nothing said'}"

    cores = [f"threads={threads}", f"env.threads={threads}"]
    begin = [f"resume='{folder}'"] if goes_on else ["task=velocity", f"robot={robot}", f"seed={seed}", *settings]
    place = [] if goes_on else [f"hydra.run.dir='{folder}'"]
    trained, began = folder / TRAINED, time.monotonic()
    failed = None if trained.is_file() else call("train", *begin, *cores, *place)
    if failed is None and not trained.is_file():
        # Of a training that was continued only the last part is known.
        write_text(trained, "" if goes_on else f"{(time.monotonic() - began) / 60:.2f}")
    failed = failed or call(
        "evaluate", f"run='{folder}'", f"episodes={EPISODES}", f"threads={threads}", "commands=true", *grid
    )
    if failed is not None:
        return {**row, "failed": failed}
    report, tested = (json.loads((folder / f"{name}.json").read_text()) for name in ("evaluation", "commands"))
    jumping = jump(folder, threads)
    progress = (folder / "progress.csv").read_text().splitlines()
    names = ("error_forward", "error_side", "error_turn", "followed_rate", "fall_rate")
    return {
        **row,
        "frames": int(float(progress[-1].split(",")[0])),
        "minutes": float(minutes) if (minutes := trained.read_text()) else None,  # of the whole command
        "versions": report["versions"],
        "resampled": {"episodes": report["episodes"], **{name: report[name] for name in names}},
        "jumping": {"episodes": jumping["episodes"], **{name: jumping[name] for name in names}},
        "followed": tested["whole"]["followed"],
        **{key: tested[key] for key in ("grid", "settle_s", "whole", "commands")},
    }


def jump(folder: Path, threads: int) -> dict[str, float | int]:
    """Evaluate a run's policy under commands that change at once, from the starts of the other evaluation."""
    torch.set_num_threads(threads)
    run, seed = load_run(folder), EvaluateSettings.seed
    task = run.setup.task.evaluated(run.settings.evaluation.reward)
    sudden = task.with_commands({NAME: replace(task.commands[NAME], acceleration=None)})
    env = build_env(sudden, run.settings.env.for_evaluation(EPISODES, threads), seed)
    return evaluate(run.policy(), env, sudden, seed).summary()


def line(row: Mapping[str, Any]) -> str:
    """A line about one robot and seed."""
    name = f"{row['robot']}, seed {row['seed']}: "
    if "failed" in row:
        return f"{name}failed, {row['failed']}"
    whole = row["whole"]
    error = whole["mean_abs_error"]
    found = "all fell" if error is None else ", ".join(f"{key} {value:.2f}" for key, value in error.items())
    return f"{name}{row['followed']} of {whole['commands']} commands followed, falls {whole['fall_rate']:.0%}, {found}"


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Format the results in Markdown: a line for each robot, medians over the seeds that did not fail."""
    head = [
        "robot",
        "seeds",
        "failed",
        "frames",
        "commands followed",
        "falls",
        "forward, m/s",
        "side, m/s",
        "turn, rad/s",
    ]
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for robot in dict.fromkeys(row["robot"] for row in rows):
        mine = [row for row in rows if row["robot"] == robot]
        done = [row for row in mine if "failed" not in row]
        cells = [robot, str(len(mine)), str(len(mine) - len(done))]
        if done:
            commands = done[0]["whole"]["commands"]
            cells += [f"{statistics.median(row['frames'] for row in done):,.0f}"]
            cells += [f"{statistics.median(row['followed'] for row in done):.0f} of {commands}"]
            cells += [f"{statistics.median(row['whole']['fall_rate'] for row in done):.0%}"]
            for axis in ("forward_m_s", "side_m_s", "turn_rad_s"):
                errors = [row["whole"]["mean_abs_error"] for row in done]
                known = [error[axis] for error in errors if error is not None]
                cells += [f"{statistics.median(known):.2f}" if known else "-"]
        lines.append(f"| {' | '.join(cells + ['-'] * (len(head) - len(cells)))} |")
    return "\n".join(lines)


def known_rows(out: Path) -> list[dict[str, Any]]:
    """Read all results."""
    return [json.loads(file.read_text()) for file in sorted(out.glob("*.json"))]


def main() -> None:
    """Train what is not trained yet, or print the table."""
    given = options(
        what="train",
        robots="go2",
        seeds="0,1,2",
        threads="1",
        settings="",
        again="",
        grid=" ".join(GRID),
        runs="runs/velocity",
        out=str(RESULTS),
    )
    out = Path(given["out"])
    if given["what"] == "table":
        print(table(known_rows(out)))
        return
    for robot in filter(None, given["robots"].split(",")):
        for seed in map(int, given["seeds"].split(",")):
            file = out / f"{title(robot)}_seed{seed}.json"
            row = json.loads(file.read_text()) if file.is_file() else None
            if row is None or given["again"] == "all" or (given["again"] == "failed" and "failed" in row):
                folder = Path(given["runs"]).absolute() / title(robot) / f"seed{seed}"
                if given["again"]:
                    shutil.rmtree(folder, ignore_errors=True)
                split = shlex.split(given["settings"]), shlex.split(given["grid"])
                row = cell(robot, seed, folder, int(given["threads"]), *split)
                out.mkdir(parents=True, exist_ok=True)
                write_text(file, json.dumps(row, indent=1) + "\n")
            print(line(row), flush=True)


if __name__ == "__main__":
    main()
