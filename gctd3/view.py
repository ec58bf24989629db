"""Watch a policy walk in a browser: ``python -m gctd3.view run=DIR``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gctd3.config.help import helped

if TYPE_CHECKING:
    from omegaconf import DictConfig


def _task(config: DictConfig) -> None:
    from gctd3.config.build import build
    from gctd3.runs.show import view

    view(build(config))


def main() -> None:
    """Run ``python -m gctd3.view``."""
    if not helped("view"):
        # Late, as everything that takes long: --help answers at once.
        from gctd3.config.command_line import command

        command("view", _task)


if __name__ == "__main__":
    main()
