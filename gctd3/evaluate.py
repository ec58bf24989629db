"""Evaluate a policy: ``python -m gctd3.evaluate run=DIR episodes=50``."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from gctd3.config.help import helped
from gctd3.files import shown

if TYPE_CHECKING:
    from omegaconf import DictConfig


def _task(config: DictConfig) -> None:
    from gctd3.config.build import build
    from gctd3.evaluation.command_grid import table as command_table
    from gctd3.evaluation.robustness import table as robustness_table
    from gctd3.runs.evaluate import (
        COMMANDS,
        COMMANDS_PICTURE,
        EVALUATION,
        ROBUSTNESS,
        ROBUSTNESS_PICTURE,
        TRACE,
        command_run,
        examine_run,
        measure_run,
        table,
        where_to_write,
        write_commands,
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
    if settings.commands:
        commanded = command_run(settings)
        print(f"\n{command_table(commanded)}", flush=True)
        write_commands(folder, commanded)
        written += [COMMANDS, COMMANDS_PICTURE]
    if folder is not None:
        files = [folder / name for name in written]
        print(f"\nWritten to {' and '.join(shown(file) for file in files if file.is_file())}")
    elif refused is None:
        print("\nNothing is written for the policy that ships with gctd3: out=DIR writes, and run=DIR to that run.")
    else:
        print(f"\n{refused}")


def main() -> None:
    """Run ``python -m gctd3.evaluate``."""
    if not helped("evaluate"):
        # Late, as everything that takes long: --help answers at once.
        from gctd3.config.command_line import command

        command("evaluate", _task)


if __name__ == "__main__":
    main()
