"""Time the whole command, as a user waits for it: an older commit and this checkout, on the same seeds in turn.

    python benchmarks/whole_command.py old=../gctd3-d2e05c5
    python benchmarks/whole_command.py old=../gctd3-d2e05c5 what=experiment=table5_best tuned= untuned=20,21,22
    python benchmarks/whole_command.py old=../gctd3-d2e05c5 threads=1 env.threads=1

``old`` is a git worktree of ``commit``; it is made if it is not there. Both builds run from their trees with the
packages of this Python. Each training is a process of its own, whose policy is then evaluated over 50 episodes by its
own build; the time of the command is what counts, from its start to its end. Results are kept after every training in
``out``, and what it holds is not run again. Other keys are passed on to the trainings, so both builds must know them.
"""

from __future__ import annotations

import csv
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from common import report

from gctd3.files import write_text

HERE = Path(__file__).resolve().parent.parent
EPISODES = 50
OWN = {
    "old": "",
    "commit": "d2e05c5",
    "what": "algo=gctd3",
    "tuned": "0,1,2,3,4,5,6,7,8,9",
    "untuned": "101,102,103,104,105,106,107,108,109,110",
    "cap": "30",  # minutes after which a training counts as failed
    "starts": "5",  # commands whose time to the first simulated step is taken
    "runs": "runs/whole_command",
    "out": "benchmarks/results/whole_command.json",
}
# What a policy must reach over the 50 episodes: that of stop_when=walk, or the two numbers that table5_best exceeds.
WALK = {"success_rate": 1.0, "return_mean": 380.0, "velocity_mean": 1.0, "stride_hz": 1.2}
WALK_MOST = {"hip_correlation": -0.5, "stride_hz": 2.4, "flight_fraction": 0.4}
FASTER = {"return_mean": 380.0, "velocity_mean": 1.414}
# Makes Python find a tree's packages as if it were installed, and notes when MuJoCo is first asked to simulate.
SITE = '''
import importlib.util, os, sys, time
TREE = os.environ["GCTD3_TREE"]
WHERE = {"gctd3": "gctd3", "gctd3.conf": "conf", "gctd3.models": "models"}

class Tree:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name in WHERE:
            folder = os.path.join(TREE, WHERE[name])
            file = os.path.join(folder, "__init__.py")
            return importlib.util.spec_from_file_location(name, file, submodule_search_locations=[folder])

class Rollout:
    """Wraps the first simulation, once mujoco.rollout is imported."""
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        if name != "mujoco.rollout":
            return None
        sys.meta_path.remove(cls)
        spec = importlib.util.find_spec(name)
        run = spec.loader.exec_module
        def exec_module(module):
            run(module)
            plain = module.Rollout.rollout
            def first(*arguments, **named):
                module.Rollout.rollout = plain
                with open(os.environ["GCTD3_FIRST"], "w") as file:
                    file.write(str(time.time()))
                return plain(*arguments, **named)
            module.Rollout.rollout = first
        spec.loader.exec_module = exec_module
        return spec

sys.meta_path.insert(0, Tree)
if "GCTD3_FIRST" in os.environ:
    sys.meta_path.insert(0, Rollout)
'''


class Build:
    """Run the commands of one source tree."""

    def __init__(self, name: str, tree: Path, site: Path) -> None:
        self.name, self.tree = name, tree
        paths = [str(site), *filter(None, [os.environ.get("PYTHONPATH")])]
        self.env = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "GCTD3_TREE": str(tree)}

    def call(self, log: Path, cap: float, command: str, *arguments: str, **more: str) -> tuple[float, float, int]:
        """Run a command; return its time (s), its largest resident memory (MB) and its exit code: -9 after ``cap``."""
        with log.open("a") as stream:
            began = time.monotonic()
            process = subprocess.Popen(
                [sys.executable, "-m", f"gctd3.{command}", *arguments],
                stdout=stream,
                stderr=subprocess.STDOUT,
                env={**self.env, **more},
                cwd=log.parent,
            )
            while True:
                ended, status, usage = os.wait4(process.pid, os.WNOHANG)
                if ended:
                    break
                if time.monotonic() - began > cap:
                    process.kill()
                time.sleep(0.02)
            process.returncode = os.waitstatus_to_exitcode(status)  # it has been waited for
        return time.monotonic() - began, usage.ru_maxrss * 1.024e-3, process.returncode

    def train(self, seed: int, run: Path, cap: float, arguments: list[str]) -> dict[str, Any]:
        """Train and evaluate one seed."""
        run.mkdir(parents=True, exist_ok=True)
        log = run / "log.txt"
        row: dict[str, Any] = {"build": self.name, "seed": seed}
        keys = [*arguments, f"seed={seed}", f"hydra.run.dir={run}"]
        row["seconds"], row["memory_mb"], row["exit_code"] = self.call(log, cap, "train", *keys)
        if (run / "progress.csv").exists():
            with (run / "progress.csv").open() as stream:
                row["curve"] = [{k: float(v) for k, v in line.items() if v} for line in csv.DictReader(stream)]
        if row["exit_code"] == 0:
            self.call(log, cap, "evaluate", f"run={run}", f"episodes={EPISODES}")
            row["evaluation"] = json.loads((run / "evaluation.json").read_text())
        return row

    def first_step(self, runs: Path, arguments: list[str]) -> float:
        """Return the time (s) from a command to the first step that is simulated."""
        runs.mkdir(parents=True, exist_ok=True)
        mark, run = runs / "first_step", runs / f"start-{self.name}-{time.time_ns()}"
        began = time.time()
        keys = [*arguments, "total_frames=100_000", "stop_when=never", f"hydra.run.dir={run}"]
        self.call(runs / "starts.txt", 600.0, "train", *keys, "time_limit=0.02", GCTD3_FIRST=str(mark))
        return float(mark.read_text()) - began


def missed(row: dict[str, Any], what: str) -> list[str]:
    """List what a policy did not reach over the episodes of its evaluation."""
    if "evaluation" not in row:
        return [f"exit code {row['exit_code']}"]
    seen = {**row["evaluation"].get("gait", {}), **row["evaluation"]}
    least, most = (FASTER, {}) if "table5_best" in what else (WALK, WALK_MOST)
    low = [f"{name} {seen.get(name)} < {bound}" for name, bound in least.items() if not seen.get(name, -1e9) >= bound]
    return low + [
        f"{name} {seen.get(name)} > {bound}" for name, bound in most.items() if not seen.get(name, 1e9) <= bound
    ]


def compare(rows: list[dict[str, Any]], seeds: list[int], what: str) -> dict[str, Any]:
    """Compare both builds over those of ``seeds`` that both have trained, and name the seeds that failed."""
    there = {name: {r["seed"]: r for r in rows if r["build"] == name} for name in ("old", "new")}
    common = [seed for seed in seeds if all(seed in those for those in there.values())]
    if not common:
        return {"seeds": 0}
    result: dict[str, Any] = {"seeds": len(common)}
    for name, those in there.items():
        seconds = [those[seed]["seconds"] for seed in common]
        failed = {seed: missed(those[seed], what) for seed in common}
        result[name] = {
            "median_s": statistics.median(seconds),
            "shortest_s": min(seconds),
            "longest_s": max(seconds),
            "memory_mb": statistics.median(those[seed]["memory_mb"] for seed in common),
            "failed": {str(seed): those for seed, those in failed.items() if those},
        }
    for figure in ("median_s", "longest_s", "memory_mb"):
        result[f"{figure}_ratio"] = result["new"][figure] / result["old"][figure]
    ratios = [there["new"][seed]["seconds"] / there["old"][seed]["seconds"] for seed in common]
    result["ratio_by_seed"] = {"median": statistics.median(ratios), "least": min(ratios), "most": max(ratios)}
    return result


def table(groups: dict[str, dict[str, Any]]) -> str:
    """Write a line for each build of each group of seeds, and the ratios below."""
    lines = [f"{'seeds':>8} {'build':>5} {'median s':>9} {'from':>7} {'to':>7} {'MB':>5}  failed"]
    for name, group in groups.items():
        if not group["seeds"]:
            continue
        for build in ("old", "new"):
            b = group[build]
            failed = "; ".join(f"{seed}: {', '.join(those)}" for seed, those in b["failed"].items()) or "none"
            times = f"{b['median_s']:>9.1f} {b['shortest_s']:>7.1f} {b['longest_s']:>7.1f} {b['memory_mb']:>5.0f}"
            lines.append(f"{name:>8} {build:>5} {times}  {failed}")
        lines.append(
            f"{'':>8} ratio: median {group['median_s_ratio']:.2f}, longest {group['longest_s_ratio']:.2f}, memory "
            f"{group['memory_mb_ratio']:.2f}; seed by seed {group['ratio_by_seed']['median']:.2f} "
            f"({group['ratio_by_seed']['least']:.2f} to {group['ratio_by_seed']['most']:.2f})"
        )
    return "\n".join(lines)


def main() -> None:
    """Train with both builds what is not in ``out`` yet, and report."""
    given = dict(argument.split("=", 1) for argument in sys.argv[1:])
    own = {key: given.pop(key, default) for key, default in OWN.items()}
    if not own["old"]:
        raise SystemExit(f"old= must name a git worktree of {own['commit']}; it is made if it is not there")
    old, out, runs = Path(own["old"]).resolve(), Path(own["out"]), Path(own["runs"]).resolve()
    site = runs / "site"
    site.mkdir(parents=True, exist_ok=True)
    write_text(site / "sitecustomize.py", SITE)
    builds = [Build("old", old, site), Build("new", HERE, site)]
    arguments = [own["what"], *(f"{key}={value}" for key, value in given.items())]
    groups = {n: [int(text) for text in own[n].split(",") if text] for n in ("tuned", "untuned")}
    before = json.loads(out.read_text()) if out.exists() else {}
    if before and before["arguments"] != arguments:
        raise SystemExit(f"{out} holds results of {' '.join(before['arguments'])}: choose another out=")
    rows, starts = before.get("trainings", []), before.get("first_step_s", {"old": [], "new": []})

    def figures() -> dict[str, Any]:
        compared = {name: compare(rows, seeds, own["what"]) for name, seeds in groups.items()}
        return {"arguments": arguments, "old": own["commit"], **compared, "first_step_s": starts, "trainings": rows}

    done = {(row["build"], row["seed"]) for row in rows}
    asked = [(build.name, seed) for build in builds for seeds in groups.values() for seed in seeds]
    if not old.exists() and (len(starts["new"]) < int(own["starts"]) or not done.issuperset(asked)):
        subprocess.run(["git", "-C", str(HERE), "worktree", "add", "--detach", str(old), own["commit"]], check=True)
    while len(starts["new"]) < int(own["starts"]):
        for build in builds:
            starts[build.name].append(build.first_step(runs, arguments))
    for turn, seed in enumerate(seed for seeds in groups.values() for seed in seeds):
        # The order changes from seed to seed, so that a drift of the machine hits both alike.
        for build in builds if turn % 2 == 0 else reversed(builds):
            if (build.name, seed) not in done:
                run = runs / own["what"].replace("=", "_") / build.name / f"{seed}-{time.time_ns()}"
                rows.append(build.train(seed, run, 60.0 * float(own["cap"]), arguments))
                write_text(out, json.dumps(figures(), indent=1) + "\n")
                print(f"{build.name} {seed}: {rows[-1]['seconds']:.1f} s", flush=True)
    result = figures()
    print(table({name: result[name] for name in groups}))
    if starts["new"]:
        first = {name: statistics.median(values) for name, values in starts.items()}
        ratio = first["new"] / first["old"]
        print(f"first simulated step after {first['old']:.2f} s (old), {first['new']:.2f} s (new): {ratio:.2f}")
    report("whole_command", result, own["out"])


if __name__ == "__main__":
    main()
