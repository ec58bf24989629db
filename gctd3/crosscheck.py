"""Check a policy in another physics engine: ``python -m gctd3.crosscheck run=DIR engine=dart``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gctd3.config.help import helped

if TYPE_CHECKING:
    from omegaconf import DictConfig


def _task(config: DictConfig) -> None:
    import json
    from pathlib import Path

    from gctd3.config.build import build
    from gctd3.engines.crosscheck import cross_check, table
    from gctd3.engines.settings import CrossCheckSettings
    from gctd3.files import check_writable, quoted, write_text

    settings: CrossCheckSettings = build(config)
    if settings.out is not None:
        check_writable(Path(settings.out))
    check = cross_check(settings)
    print(table(check), flush=True)
    if settings.out is not None:
        write_text(Path(settings.out), json.dumps(check.report(), indent=1) + "\n")
        print(f"Written to {quoted(settings.out)}")
    if check.reasons():
        raise SystemExit(1)


def main() -> None:
    """Run ``python -m gctd3.crosscheck``."""
    if not helped("crosscheck"):
        # Late, as everything that takes long: --help answers at once.
        from gctd3.config.command_line import command

        command("crosscheck", _task)


if __name__ == "__main__":
    main()
