"""Watch a policy walk in a browser: ``python -m gctd3.view run=DIR``."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import platform
import socket
import webbrowser
from pathlib import Path

import torch

from gctd3.errors import ConfigError, RunError
from gctd3.files import quoted
from gctd3.runs.load import load_run
from gctd3.runs.settings import ViewSettings
from gctd3.training.checkpoint import Checkpoints
from gctd3.training.saved_configuration import find_run
from gctd3.viz.live_session import LiveWalk

PACKAGES = ("viser", "mjviser")
SHIPPED = "shipped with gctd3"  # name of the policy in the package among runs


def open_walk(run: str, settings: ViewSettings) -> LiveWalk:
    """Load the policy of one of the :func:`choices`, ready to walk.

    Raises:
        RunError: If it is no run, or not of the walking task.
    """
    loaded = load_run(None if run == SHIPPED else run)
    task = loaded.task("film")
    return LiveWalk(loaded.policy(), task.without_end() if settings.endless else task, settings.seed)


def choices(run: str | None, runs: str) -> list[str]:
    """List the run, all others with a policy below a directory, newest first, and the one in the package."""
    directories = [path.parent for path in Path(runs).rglob("checkpoints") if path.is_dir()]
    others = sorted(
        (path for path in directories if _has_policy(path)), key=lambda path: path.stat().st_mtime, reverse=True
    )
    mine = find_run(run).resolve()
    names = [str(path) for path in others if path.resolve() != mine]
    return [SHIPPED, *names] if run is None else [run, *names, SHIPPED]


def _has_policy(run: Path) -> bool:
    with contextlib.suppress(RunError):
        return Checkpoints(run).best().is_dir()
    return False


def check_packages() -> None:
    """Raise a :class:`.ConfigError` unless the packages that draw in a browser are installed."""
    missing = [name for name in PACKAGES if importlib.util.find_spec(name) is None]
    if missing:
        raise ConfigError(f"The viewer needs {' and '.join(missing)}: pip install 'gctd3[view]'.")


def check_port(host: str, port: int) -> None:
    """Raise a :class:`.ConfigError` unless a server can listen on ``port`` of ``host``; viser would take another."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            if os.name == "posix":  # as the server itself does, so that a port just left counts as free
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        raise ConfigError(
            f"port={port} of host={host} cannot be used: {error.strerror}. Choose another, or port=0 for any that is "
            "free."
        ) from error


def view(settings: ViewSettings) -> None:
    """Show a walk until Ctrl-C.

    Raises:
        ConfigError: If a package is missing or the port is in use.
        RunError: If the run cannot be shown.
    """
    check_packages()
    check_port(settings.host, settings.port)
    names = choices(settings.run, settings.runs)
    first = open_walk(names[0], settings)
    import rich

    from gctd3.viz.browser_panel import Panel
    from gctd3.viz.viewer_server import serve

    # One robot is too little work to share; and viser's announcements are made below.
    torch.set_num_threads(1)
    rich.reconfigure(quiet=True)
    server = serve(settings.host, settings.port, settings.allowed_hosts)
    try:
        loaded = {names[0]: first}
        panel = Panel(server, lambda run: loaded.pop(run, None) or open_walk(run, settings), names, settings.seed)
        _announce(settings, server.get_port())
        with contextlib.suppress(KeyboardInterrupt):
            panel.run()
    finally:
        server.stop()


def _announce(settings: ViewSettings, port: int) -> None:
    url = f"http://{settings.host}:{port}"
    print(
        f"{quoted(settings.run) if settings.run else f'The policy {SHIPPED}'} walks at {url}; Ctrl-C ends it.",
        flush=True,
    )
    screen = platform.system() != "Linux" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    if settings.browser and not (screen and webbrowser.open(url)):
        print(
            f"There is no browser here. From another machine: ssh -L {port}:{settings.host}:{port} "
            f"{socket.gethostname()}, then open http://localhost:{port} there.",
            flush=True,
        )
