"""``python -m gctd3``: what commands there are; ``python -m gctd3 train ...`` is ``python -m gctd3.train ...``."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

from gctd3.config.help import COMMANDS, HELP, asks_for_help, check_installed, fail, help_of, overview
from gctd3.errors import suggest


def run(command: str) -> None:
    """Run a command on the command line; ``--help`` is answered without the packages that the command needs."""
    check_installed()
    if asks_for_help():
        print(help_of(command))
        return
    import_module(f"gctd3.{command}").main()


def script() -> None:
    """Entry point of the scripts ``gctd3-train`` and so on: the command is in their name."""
    run(Path(sys.argv[0]).name.removesuffix(".exe").removesuffix("-script.py").removeprefix("gctd3-"))


def main() -> None:
    """Entry point of ``python -m gctd3`` and of the script ``gctd3``."""
    check_installed()
    command = sys.argv[1] if len(sys.argv) > 1 else HELP[0]
    if command in HELP:
        print(overview())
    elif command in COMMANDS:
        del sys.argv[1]
        run(command)
    else:
        fail(f"There is no command {command!r}.{suggest(command, COMMANDS)} Commands: {', '.join(COMMANDS)}.")


if __name__ == "__main__":
    main()
