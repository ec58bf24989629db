"""Settings searched with Optuna, a training for each trial: the return of its best policy is what counts.

Trials are kept in a journal: the same command goes on where an earlier one stopped, and several at once share the work.

    pip install optuna
    python examples/tune.py --trials 20 --frames 100000 --out tuning
    python examples/tune.py --trials 20 --frames 100000 --out tuning algo=sac threads=1 env.threads=1
"""

from __future__ import annotations

import argparse
import csv
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

try:
    import optuna
    from optuna.storages import JournalStorage
    from optuna.storages.journal import JournalFileBackend
    from optuna.trial import Trial, TrialState
except ModuleNotFoundError as error:
    raise SystemExit(f"error: examples/tune.py needs {error.name}: pip install 'optuna>=4'") from error


def suggest(trial: Trial) -> dict[str, float]:
    """Suggest values to search over, for any keys of the training's configuration."""
    return {
        "algo.learning_rate": trial.suggest_float("algo.learning_rate", 1e-4, 1e-3, log=True),
        "algo.tau": trial.suggest_float("algo.tau", 1e-3, 2e-2, log=True),
        "replay.n_step": trial.suggest_int("replay.n_step", 1, 5),
        "gradient_steps": trial.suggest_int("gradient_steps", 2, 8),
    }


def returns(run: Path) -> float:
    """The highest return among a run's evaluations."""
    with (run / "progress.csv").open(encoding="utf-8") as file:
        return max(float(row["return_mean"]) for row in csv.DictReader(file))


def main(arguments: Sequence[str] | None = None) -> float:
    """Search.

    Returns:
        The best trial's return.
    """
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=20, help="trainings that come to their end, all together")
    parser.add_argument("--frames", type=int, default=100_000, help="of each training")
    parser.add_argument("--seed", type=int, default=0, help="of the trainings")
    parser.add_argument("--out", type=Path, default=Path("tuning"), help="directory of the journal and the runs")
    parser.add_argument("overrides", nargs="*", help="key=value for every training")
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)

    def objective(trial: Trial) -> float:
        run = options.out / f"trial{trial.number}"
        settings = {"seed": options.seed, "total_frames": options.frames, "stop_when": "never", **suggest(trial)}
        command = [sys.executable, "-m", "gctd3.train", *options.overrides]
        command += [f"{key}={value}" for key, value in settings.items()] + [f"hydra.run.dir={run}"]
        with (options.out / f"trial{trial.number}.txt").open("w", encoding="utf-8") as log:
            # A training that crashes is a trial that failed; the search goes on.
            subprocess.run(command, check=True, stdout=log, stderr=subprocess.STDOUT)
        return returns(run)

    study = optuna.create_study(
        study_name="gctd3",
        storage=JournalStorage(JournalFileBackend(str(options.out / "journal.log"))),
        load_if_exists=True,
        direction="maximize",
    )
    enough = optuna.study.MaxTrialsCallback(options.trials, states=(TrialState.COMPLETE,))
    done = len(study.get_trials(states=(TrialState.COMPLETE,)))
    if done < options.trials:
        failing = (subprocess.CalledProcessError,)
        study.optimize(objective, n_trials=options.trials - done, callbacks=[enough], catch=failing)
    print(f"\nBest of {len(study.trials)}: return {study.best_value:.1f} with")
    print("  " + " ".join(f"{key}={value:g}" for key, value in study.best_params.items()))
    return study.best_value


if __name__ == "__main__":
    main()
