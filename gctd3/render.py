"""Draw a policy's walk: ``python -m gctd3.render run=DIR out=walk.mp4``."""

from __future__ import annotations

from omegaconf import DictConfig

from gctd3.config.build import build
from gctd3.config.command_line import command
from gctd3.files import shown


def _task(config: DictConfig) -> None:
    from gctd3.runs.draw import render_run

    print(f"Written to {shown(render_run(build(config)))}")


def main() -> None:
    """Run ``python -m gctd3.render``."""
    command("render", _task)


if __name__ == "__main__":
    main()
