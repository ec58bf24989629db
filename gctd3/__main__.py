"""``python -m gctd3`` lists the commands; ``python -m gctd3 train ...`` is ``python -m gctd3.train ...``."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

from gctd3.config.help import COMMANDS, HELP, asks_for_help, check_installed, fail, help_of, overview, show
from gctd3.config.terminal import prepare_output
from gctd3.errors import suggest


def run(command: str) -> None:
    """Run a command with the command line's arguments; ``--help`` works without the packages that the command needs."""
    prepare_output()
    check_installed()
    if asks_for_help():
        show(help_of(command))
        return
    import_module(f"gctd3.{command}").main()


def script() -> None:
    """Run the command in the name of the script, as entry point of ``gctd3-train`` and so on."""
    run(Path(sys.argv[0]).name.removesuffix(".exe").removesuffix("-script.py").removeprefix("gctd3-"))


def main() -> None:
    """Run a command or list all, as entry point of ``python -m gctd3`` and of the script ``gctd3``."""
    prepare_output()
    check_installed()
    command = sys.argv[1] if len(sys.argv) > 1 else HELP[0]
    if command in HELP:
        show(overview())
    elif command in COMMANDS:
        del sys.argv[1]
        run(command)
    else:
        fail(f"There is no command {command!r}.{suggest(command, COMMANDS)} Commands: {', '.join(COMMANDS)}.")


if __name__ == "__main__":
    main()
