"""Compare runs in one page: ``python -m gctd3.report runs=DIR out=DIR``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gctd3.config.help import helped
from gctd3.files import quoted

if TYPE_CHECKING:
    from omegaconf import DictConfig


def _task(config: DictConfig) -> None:
    from gctd3.comparison.output_directory import VERDICT
    from gctd3.comparison.report import report
    from gctd3.comparison.settings import ReportSettings
    from gctd3.config.build import build

    settings: ReportSettings = build(config)
    file = report(settings)
    print((file.parent / VERDICT).read_text(encoding="utf-8"))
    print(f"Written to {quoted(file)}")


def main() -> None:
    """Run ``python -m gctd3.report``."""
    if not helped("report"):
        # Late, as everything that takes long: --help answers at once.
        from gctd3.config.command_line import command

        command("report", _task)


if __name__ == "__main__":
    main()
