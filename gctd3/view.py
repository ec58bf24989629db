"""Watch a policy walk in a browser: ``python -m gctd3.view run=DIR``."""

from __future__ import annotations

from omegaconf import DictConfig

from gctd3.config.build import build
from gctd3.config.command_line import command


def _task(config: DictConfig) -> None:
    from gctd3.runs.show import view

    view(build(config))


def main() -> None:
    """Run ``python -m gctd3.view``."""
    command("view", _task)


if __name__ == "__main__":
    main()
