"""Put the best policy of a run into the package, where commands find it that are given no run.

    python benchmarks/ship_policy.py run=DIR [commit=COMMIT] [to=models/biped/policy]

Evaluates it over 50 episodes first, and refuses one that does not walk as ``conf/stop_when/walk.yaml`` says. What is
written is a run without its training: configuration, robot, policy, ``evaluation.json``. ``commit`` is the one that
trained it, by default this checkout's.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from importlib import resources
from pathlib import Path

from common import commit, options
from omegaconf import OmegaConf

from gctd3.config.build import build
from gctd3.files import OWN_ROBOT, new_directory, write_manifest
from gctd3.runs.evaluate import EVALUATION, evaluate_run, table
from gctd3.runs.settings import EvaluateSettings
from gctd3.tasks.reward import Reward
from gctd3.training.checkpoint import POLICY, Checkpoints, checked
from gctd3.training.saved_configuration import CONFIG, OVERRIDES, load_settings
from gctd3.training.stop_when import StopWhen

EPISODES = 50
MOST_BYTES = 1_000_000


def fill(folder: Path, run: Path, trained_at: str) -> list[str]:
    """Evaluate a run's best policy and copy what is shipped of it into an empty folder.

    Returns:
        What of a walk it does not show, by the name of the metric.
    """
    with tempfile.TemporaryDirectory() as evaluated:
        report = evaluate_run(EvaluateSettings(run=str(run), reward=Reward(), episodes=EPISODES, out=evaluated))
        shutil.copyfile(Path(evaluated, EVALUATION), folder / EVALUATION)
    print(table(report))
    best = Checkpoints(run).best()
    target = folder / best.relative_to(run)
    target.mkdir(parents=True)
    shutil.copyfile(best / POLICY, target / POLICY)
    write_manifest(target, {**checked(best), "commit": trained_at})
    for file in (CONFIG, OVERRIDES):
        (folder / file).parent.mkdir(exist_ok=True)
        shutil.copyfile(run / file, folder / file)
    shutil.copytree(run / OWN_ROBOT, folder / OWN_ROBOT)
    return lacking(json.loads((folder / EVALUATION).read_text(encoding="utf-8")))


def lacking(evaluation: dict[str, object]) -> list[str]:
    """Metrics that are not a walk's."""
    walk: StopWhen = build(OmegaConf.load(str(resources.files("gctd3.conf") / "stop_when" / "walk.yaml")))
    found = {**evaluation, **dict(evaluation["gait"])}  # type: ignore[call-overload]
    numbers = {key: float(value) for key, value in found.items() if isinstance(value, (int, float))}
    bounds = [StopWhen(at_least={name: bound}) for name, bound in walk.at_least.items()]
    bounds += [StopWhen(at_most={name: bound}) for name, bound in walk.at_most.items()]
    return sorted({name for b in bounds for name in (*b.at_least, *b.at_most) if not b.all_reached(numbers)})


def main() -> None:
    """Evaluate, copy, put in place."""
    given = options(run="", commit="", to=str(Path(__file__).parents[1] / "models" / "biped" / "policy"))
    if not given["run"]:
        raise SystemExit("run=DIR is required")
    run, to, trained_at = Path(given["run"]), Path(given["to"]), given["commit"] or commit()
    if trained_at == "unknown" or trained_at.endswith("-dirty"):
        raise SystemExit(f"this checkout is at {trained_at}: commit first, or say commit=...")
    if (name := load_settings(run).robot.name) != to.parent.name:
        raise SystemExit(f"{run} is of the robot {name}, {to} is for {to.parent.name}")
    with new_directory(to.with_name(f"{to.name}.new")) as aside:
        if missed := fill(aside, run, trained_at):
            raise SystemExit(f"{run} does not walk: {', '.join(missed)}")
        size = sum(file.stat().st_size for file in aside.rglob("*") if file.is_file())
        if size > MOST_BYTES:
            raise SystemExit(f"{run} takes {size:,} bytes, allowed are {MOST_BYTES:,}")
    shutil.rmtree(to, ignore_errors=True)
    to.with_name(f"{to.name}.new").rename(to)
    print(f"\nWritten to {to}: {size:,} bytes, trained at {trained_at}")


if __name__ == "__main__":
    main()
