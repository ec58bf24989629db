"""Evaluate a policy: ``python -m gctd3.evaluate run=DIR episodes=50``."""

from __future__ import annotations

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
    if settings.folder is None:
        print("\nNothing is written for the policy that ships with gctd3: out=DIR writes, and run=DIR to that run.")
    else:
        files = [settings.folder / name for name in written]
        print(f"\nWritten to {' and '.join(str(file) for file in files if file.is_file())}")


def main() -> None:
    """Run ``python -m gctd3.evaluate``."""
    if not helped("evaluate"):
        # Late, as everything that takes long: --help answers at once.
        from gctd3.config.command_line import command

        command("evaluate", _task)


if __name__ == "__main__":
    main()
