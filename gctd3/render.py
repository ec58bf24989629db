"""Draw a policy's walk: ``python -m gctd3.render run=DIR out=walk.mp4``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gctd3.config.help import helped
from gctd3.files import quoted

if TYPE_CHECKING:
    from omegaconf import DictConfig


def _task(config: DictConfig) -> None:
    from gctd3.config.build import build
    from gctd3.runs.draw import render_run

    print(f"Written to {quoted(render_run(build(config)))}")


def main() -> None:
    """Run ``python -m gctd3.render``."""
    if not helped("render"):
        # Late, as everything that takes long: --help answers at once.
        from gctd3.config.command_line import command

        command("render", _task)


if __name__ == "__main__":
    main()
