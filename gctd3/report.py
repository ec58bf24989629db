"""Compare runs in one page: ``python -m gctd3.report runs=DIR out=DIR``."""

from __future__ import annotations

from omegaconf import DictConfig

from gctd3.config.build import build
from gctd3.config.command_line import command
from gctd3.files import shown


def _task(config: DictConfig) -> None:
    from gctd3.comparison.output_directory import VERDICT
    from gctd3.comparison.report import report
    from gctd3.comparison.settings import ReportSettings

    settings: ReportSettings = build(config)
    file = report(settings)
    print((file.parent / VERDICT).read_text(encoding="utf-8"))
    print(f"Written to {shown(file)}")


def main() -> None:
    """Run ``python -m gctd3.report``."""
    command("report", _task)


if __name__ == "__main__":
    main()
