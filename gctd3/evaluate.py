"""Evaluate a policy: ``python -m gctd3.evaluate run=DIR episodes=50``."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from gctd3.config.help import helped

if TYPE_CHECKING:
    from omegaconf import DictConfig


def _task(config: DictConfig) -> None:
    from gctd3.config.build import build
    from gctd3.evaluation.robustness import table as robustness_table
    from gctd3.runs.evaluate import (
        EVALUATION,
        ROBUSTNESS,
        ROBUSTNESS_PICTURE,
        TRACE,
        examine_run,
        measure_run,
        table,
        where_to_write,
        where_written,
        write_evaluation,
        write_robustness,
    )
    from gctd3.runs.settings import EvaluateSettings

    settings: EvaluateSettings = build(config)
    # Before the simulation, which may be long.
    folder, refused = where_to_write(settings)
    if refused is not None:
        print(refused, file=sys.stderr, flush=True)
    report, motion = measure_run(settings)
    print(table(report), flush=True)
    # After the table, so that a disk that is full by now does not cost it.
    write_evaluation(folder, report, motion)
    written = [EVALUATION, TRACE]
    if settings.robustness:
        gait = report["gait"]
        results = examine_run(settings, gait.get("stride_time") if isinstance(gait, dict) else None)
        print(f"\n{robustness_table(results)}", flush=True)
        write_robustness(folder, results)
        written += [ROBUSTNESS, ROBUSTNESS_PICTURE]
    print(f"\n{refused or where_written(folder, written)}")


def main() -> None:
    """Run ``python -m gctd3.evaluate``."""
    if not helped("evaluate"):
        # Late, as everything that takes long: --help answers at once.
        from gctd3.config.command_line import command

        command("evaluate", _task)


if __name__ == "__main__":
    main()
