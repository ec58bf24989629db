"""Train a policy: ``python -m gctd3.train algo=gctd3``; continue one: ``python -m gctd3.train resume=DIR``."""

from __future__ import annotations

import contextlib
import gc
import math
from collections.abc import Callable, Iterator
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from gctd3.compat import postpone_compiler
from gctd3.config.build import again, build, packages
from gctd3.config.paths import escaped
from gctd3.config.terminal import enduring_output
from gctd3.errors import RunError
from gctd3.files import quoted, refuse_links, remove, remove_empty, remove_leftovers
from gctd3.robots.keep import has_robot, keep_robot
from gctd3.signals import StopRequest
from gctd3.training.announcements import best_text, closing, opening
from gctd3.training.own_process import in_own_process
from gctd3.training.run_lock import only_one
from gctd3.training.saved_configuration import CONFIG, changed, changes_of_arithmetic, load_config, save_config
from gctd3.training.saved_robot import setup_of
from gctd3.training.sweep import LOST, lost, share_cores, stop_file

LOG = "log.txt"  # output of runs side by side
WORST = -1e9  # result of a run without a policy: below every return, and finite


def train(config: DictConfig) -> float:
    """Check the configuration, train a policy and report the result.

    Returns:
        The return of the best policy, for a sweeper to maximise; :data:`WORST` if none was evaluated.
    """
    stop = StopRequest(stop_file())
    if stop.file is not None:
        # One of several runs of a sweep side by side: its end must not end the sweep's process.
        return WORST if stop else _beside(config, stop.file.parent)
    # Listen before the imports: one that a signal interrupts would look like a missing package.
    with stop.listening():
        best = _train(config, stop)
    if stop:
        raise SystemExit(stop.exit_code)
    return value(best)


def _beside(config: DictConfig, sweep: Path) -> float:
    """Train in a process of its own."""
    run = Path(HydraConfig.get().runtime.output_dir)
    if str(run) in lost(sweep):
        raise RunError("Its process was killed. It goes on from its last checkpoint, once the sweep is continued.")
    result: float = in_own_process(_in_own_process, config, run, sweep / LOST)
    return result


def _in_own_process(config: DictConfig) -> float:
    return value(_train(config, StopRequest(stop_file())))


def _train(config: DictConfig, stop: StopRequest) -> dict[str, float] | None:
    resumed, overrides = config.resume is not None, list(HydraConfig.get().overrides.task)
    run = Path(str(config.resume)) if resumed else Path(HydraConfig.get().runtime.output_dir)
    # A sweep into the directory of an earlier one goes on where that one stopped.
    sweeping = HydraConfig.get().mode is RunMode.MULTIRUN
    if resumed and not (run / CONFIG).is_file():
        raise RunError(f"resume={run}: there is no run to continue; a run has a {CONFIG}.")
    resumed = resumed or (sweeping and (run / CONFIG).is_file())
    # What the command line itself names is the user's: a sweep that goes on names its terms again.
    own = packages(config)
    differs: str | None = None
    if resumed:
        before = load_config(run)
        config, overrides = changed(run, "config", overrides)
    if stop.file is not None:
        share_cores(config)
    if config.init is not None:
        # The run goes on in any directory.
        config.init = escaped(str(Path(config.init).absolute()))
    if resumed:
        differs = changes_of_arithmetic(before, config)
    settings = build(config, trusted=not resumed, besides=own)
    if not settings.algo.compile:
        postpone_compiler()
    settings.check_here()
    setup = setup_of(run, settings) if resumed else settings.setup()
    # Before anything is written: a robot that cannot be mirrored as asked is refused.
    setup.mirrors(settings.replay.mirror)
    # Imported late, so that --help and a wrong setting are answered at once.
    from gctd3.training.checkpoint import FOLDER
    from gctd3.training.post_mortem import POST_MORTEM
    from gctd3.training.run_log import refuse_a_run
    from gctd3.training.trainer import Trainer

    if settings.video:
        from gctd3.viz.film import check_film

        check_film()
    walks = "film" in setup.task.abilities
    trainer: Trainer | None = None

    def begun() -> bool:
        left = [*(run / FOLDER).glob("*"), *run.glob(POST_MORTEM)]
        return bool(left) or (trainer is not None and trainer.counters.frames > 0)

    refuse_links(run, besides=("wandb",))  # which makes links of its own
    with _removed_unless(begun, run), only_one(run), _output(run, stop):
        if not resumed:
            refuse_a_run(run)
        for folder in (run, (run / CONFIG).parent):
            remove_leftovers(folder)
        if settings.robot.takes_a_source and setup.robot.source is not None:
            # A run keeps to its file, whatever else is installed when it is continued or evaluated.
            config.robot.source = setup.robot.source.place
        trainer = Trainer(settings, run, {"config": OmegaConf.to_container(config, resolve=True)}, setup)
        if resumed and not trainer.restore():
            print(f"{quoted(run)} has no checkpoint yet: it starts from the beginning.")
        if not (resumed and has_robot(run)):
            keep_robot(setup.robot, run)
        save_config(run, config, overrides)
        begins = [opening(config, setup.task.name, run, overrides)]
        begins += [str(setup.mirror_check)] if settings.replay.mirror else []
        begins += [differs] if differs is not None else []
        begins += ["", f"{setup.robot.origin}\n"] if setup.robot.origin else [""]
        # Who has read where the run is may read no further.
        with enduring_output():
            print("\n".join(begins), flush=True)
        if trainer.finished and sweeping:
            print("It is finished already.")
        elif trainer.finished:
            raise RunError(
                f"{run} is finished after {trainer.counters.frames:,} frames. To train on, raise total_frames, and "
                "stop_when.evaluations or stop_when.evaluations=null if its conditions ended it."
            )
        # From here on there is a result, which does not depend on who reads about it.
        with enduring_output():
            gc.enable()  # which the command disabled for its start
            trainer.run(stop)
            print(closing(trainer.evaluations.best, run, config, walks, trainer.finished))
            if not trainer.finished:
                print(f"Continue it:  {again(config, 'train', f'resume={run}')}")
    best = trainer.evaluations.best
    if stop.file is not None:
        with enduring_output():
            print(f"{quoted(run)}: {'stopped' if stop else 'done'}. {best_text(best, walks)}", flush=True)
    return best


@contextlib.contextmanager
def _removed_unless(begun: Callable[[], bool], run: Path) -> Iterator[None]:
    """Remove the directory of a new run that fails before its training has begun: there is nothing to continue."""
    new = not run.is_dir() or not any(run.iterdir())
    try:
        yield
    except BaseException:
        if new and not begun():
            for item in run.iterdir():
                remove(item)
            remove_empty(run)
        raise


@contextlib.contextmanager
def _output(run: Path, stop: StopRequest) -> Iterator[None]:
    """Redirect the output of a run beside others to its log: on one screen their lines could not be told apart."""
    if stop.file is None:
        yield
        return
    print(f"{quoted(run)}: begins; its output is in its {LOG}", flush=True)
    with (
        (run / LOG).open("a", encoding="utf-8", buffering=1) as log,
        contextlib.redirect_stdout(log),
        contextlib.redirect_stderr(log),
    ):
        yield


def value(best: dict[str, float] | None) -> float:
    """Return the result of a run for a sweeper, which is always finite."""
    # Not NaN, at which a search ends (hydra-optuna-sweeper 1.3.0), whatever failures it allows.
    return WORST if best is None or not math.isfinite(best["return_mean"]) else best["return_mean"]
