"""Evaluate a policy: ``python -m gctd3.evaluate run=DIR episodes=50``."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from gctd3.config.help import helped

if TYPE_CHECKING:
    from omegaconf import DictConfig


def _task(config: DictConfig) -> None:
    from gctd3.config.build import build
    from gctd3.evaluation import command_grid, robustness
    from gctd3.runs import evaluate as of_run
    from gctd3.runs.settings import EvaluateSettings

    settings: EvaluateSettings = build(config)
    # Before the simulation, which may be long.
    folder, refused = of_run.where_to_write(settings)
    if refused is not None:
        print(refused, file=sys.stderr, flush=True)
    measured = of_run.measure_run(settings)
    print(of_run.table(measured.report), flush=True)
    # After the table, so that a disk that is full by now does not cost it.
    of_run.write_evaluation(folder, measured)
    if settings.bag is not None and measured.typical is not None:
        from gctd3.bridge.bags import write_walk

        print(write_walk(settings.bag, measured.typical, measured.robot, measured.control_dt), flush=True)
    written = [of_run.EVALUATION, of_run.TRACE]
    if settings.robustness:
        gait = measured.report["gait"]
        results = of_run.examine_run(settings, gait.get("stride_time") if isinstance(gait, dict) else None)
        print(f"\n{robustness.table(results)}", flush=True)
        of_run.write_robustness(folder, results)
        written += [of_run.ROBUSTNESS, of_run.ROBUSTNESS_PICTURE]
    if settings.commands:
        results = of_run.command_run(settings)
        print(f"\n{command_grid.table(results)}", flush=True)
        of_run.write_commands(folder, results)
        written += [of_run.COMMANDS, of_run.COMMANDS_PICTURE]
    print(f"\n{refused or of_run.where_written(folder, written)}")


def main() -> None:
    """Run ``python -m gctd3.evaluate``."""
    if not helped("evaluate"):
        # Late, as everything that takes long: --help answers at once.
        from gctd3.config.command_line import command

        command("evaluate", _task)


if __name__ == "__main__":
    main()
