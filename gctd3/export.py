"""Export a policy to run elsewhere: ``python -m gctd3.export run=DIR out=policy.onnx``."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from gctd3.config.help import helped
from gctd3.files import quoted

if TYPE_CHECKING:
    from omegaconf import DictConfig


def _task(config: DictConfig) -> None:
    from gctd3.config.build import build
    from gctd3.deploy.export import export_run

    exported = export_run(build(config))
    print(f"Actions differ from PyTorch's by at most {exported.difference:.1e} over {exported.states:,} states.")
    for line in exported.warnings:
        print(f"Warning: {line}", file=sys.stderr)
    print(f"Written to {' and '.join(map(quoted, exported.files))}")


def main() -> None:
    """Run ``python -m gctd3.export``."""
    if not helped("export"):
        # Late, as everything that takes long: --help answers at once.
        from gctd3.config.command_line import command

        command("export", _task)


if __name__ == "__main__":
    main()
