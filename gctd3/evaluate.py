"""Evaluate a policy: ``python -m gctd3.evaluate run=DIR episodes=50``."""

from __future__ import annotations

from omegaconf import DictConfig

from gctd3.config.build import build
from gctd3.config.command_line import command


def _task(config: DictConfig) -> None:
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
        evaluate_run,
        examine_run,
        table,
    )
    from gctd3.runs.settings import EvaluateSettings

    settings: EvaluateSettings = build(config)
    report = evaluate_run(settings)
    print(table(report))
    written = [EVALUATION, TRACE]
    if settings.robustness:
        gait = report["gait"]
        results = examine_run(settings, gait.get("stride_time") if isinstance(gait, dict) else None)
        print(f"\n{robustness_table(results)}")
        written += [ROBUSTNESS, ROBUSTNESS_PICTURE]
    if settings.commands:
        print(f"\n{command_table(command_run(settings))}")
        written += [COMMANDS, COMMANDS_PICTURE]
    if settings.folder is not None:
        files = [settings.folder / name for name in written]
        print(f"\nWritten to {' and '.join(str(file) for file in files if file.is_file())}")


def main() -> None:
    """Run ``python -m gctd3.evaluate``."""
    command("evaluate", _task)


if __name__ == "__main__":
    main()
