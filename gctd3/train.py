"""Train a policy: ``python -m gctd3.train algo=gctd3``; continue one: ``python -m gctd3.train resume=DIR``."""

from __future__ import annotations

import sys
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from gctd3.cli import command
from gctd3.errors import RunError
from gctd3.interrupt import StopRequest, only_one
from gctd3.run_config import CONFIG, changed, save_config
from gctd3.settings import build


def train(config: DictConfig) -> None:
    """Check the configuration, train, say what was reached."""
    stop = StopRequest()
    # From the start: an import that a signal broke off would look like a missing package.
    with stop.listening():
        _train(config, stop)
    if stop:
        raise SystemExit(stop.exit_code)


def _train(config: DictConfig, stop: StopRequest) -> None:
    resumed, overrides = config.resume is not None, list(HydraConfig.get().overrides.task)
    run = Path(str(config.resume)) if resumed else Path(HydraConfig.get().runtime.output_dir)
    # A sweep into the directory of an earlier one goes on where that one stopped.
    sweeping = HydraConfig.get().mode is RunMode.MULTIRUN
    if resumed and not (run / CONFIG).is_file():
        raise RunError(f"resume={run}: there is no run to continue; a run has a {CONFIG}.")
    resumed = resumed or (sweeping and (run / CONFIG).is_file())
    if resumed:
        config, overrides = changed(run, "config", overrides)
    settings = build(config)
    settings.check_here()
    # Imported late, so that --help and a wrong setting are answered at once.
    from gctd3.run_log import refuse_a_run
    from gctd3.trainer import Trainer

    with only_one(run):
        if not resumed:
            refuse_a_run(run)
        trainer = Trainer(settings, run, {"config": OmegaConf.to_container(config, resolve=True)})
        if resumed and not trainer.restore():
            print(f"{run} has no checkpoint yet: it starts from the beginning.")
        save_config(run, config, overrides)
        print(OmegaConf.to_yaml(config))
        print(f"Run directory: {run}\n", flush=True)
        if trainer.finished and sweeping:
            print("It is finished already.")
        elif trainer.finished:
            raise RunError(
                f"{run} is finished after {trainer.counters.frames:,} steps. To train on, raise total_frames, and "
                "stop_when.evaluations or stop_when.evaluations=null if its conditions ended it."
            )
        trainer.run(stop)
    print(_summary(trainer.best, run))
    if not trainer.finished:
        print(f"Continue it:  python -m gctd3.train resume={run}")


def _summary(best: dict[str, float] | None, run: Path) -> str:
    if best is None:
        return "\nIt has not been evaluated yet, so there is no policy to judge."
    return (
        f"\nBest evaluation, after {best['frames']:,.0f} steps and {best['wall_s'] / 60:.1f} minutes: "
        f"return {best['return_mean']:.1f} ± {best['return_std']:.1f}, success {best['success_rate']:.0%}, "
        f"{best['distance_mean']:.1f} m at {best['velocity_mean']:.2f} m/s.\n"
        f"Judge it over 50 episodes:  python -m gctd3.evaluate run={run} episodes=50"
    )


def main() -> None:
    """Entry point of ``python -m gctd3.train``."""
    resumed = [argument.split("=", 1)[1] for argument in sys.argv[1:] if argument.startswith("resume=")]
    if resumed and resumed[-1] not in ("null", ""):
        # Hydra's own directory is the run's, so that nothing is written elsewhere; nor made if there is no run.
        there = (Path(resumed[-1]) / CONFIG).is_file()
        sys.argv.append(f"hydra.run.dir='{resumed[-1] if there else '.'}'")
    command("config", train)


if __name__ == "__main__":
    main()
