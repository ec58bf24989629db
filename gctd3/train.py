"""Train a policy: ``python -m gctd3.train algo=gctd3``; continue one: ``python -m gctd3.train resume=DIR``."""

from __future__ import annotations

import contextlib
import gc
import sys
from pathlib import Path

from gctd3.config.help import helped
from gctd3.errors import RunError
from gctd3.robots.command_line import robot_file


def main() -> None:
    """Run ``python -m gctd3.train``."""
    if helped("config"):
        return
    # Imports and configurations make a million objects that stay: to look for garbage among them takes half a second.
    gc.disable()
    try:
        _main()
    finally:
        gc.enable()


def _main() -> None:
    # Late, as everything that takes long: --help answers at once.
    from gctd3.compat import without_screen
    from gctd3.config.command_line import command
    from gctd3.config.paths import plain, quoted

    with without_screen():
        import mujoco  # noqa: F401 - first here
    from gctd3.training.saved_configuration import CONFIG, HARMLESS, choices
    from gctd3.training.session import train
    from gctd3.training.sweep import end

    resumed = [plain(argument.split("=", 1)[1]) for argument in sys.argv[1:] if argument.startswith("resume=")]
    going_on = bool(resumed) and resumed[-1] not in ("null", "")
    if going_on:
        # Hydra writes to the run's directory, so that no other one is made; without a run it makes none.
        exists = (Path(resumed[-1]) / CONFIG).is_file()
        if exists:
            # A damaged file is reported once Hydra runs.
            with contextlib.suppress(RunError):
                sys.argv[1:1] = choices(Path(resumed[-1]), sys.argv[1:])
        # Hydra would read an interpolation there.
        itself = exists and "${" not in resumed[-1]
        sys.argv.append(f"hydra.run.dir={quoted(resumed[-1]) if itself else '.'}")
    command("config", train, robot_file, HARMLESS[:-1] if going_on else (), end)


if __name__ == "__main__":
    main()
