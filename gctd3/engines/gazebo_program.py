"""The program that speaks to Gazebo's physics library: it is compiled once for each version of itself and the library.

The library has no Python package. Debian 12 has it as ``libignition-physics-dev``.
"""

from __future__ import annotations

import hashlib
import os
import platform
import shlex
import shutil
import stat
import subprocess
from pathlib import Path

from gctd3.errors import ConfigError, EngineError
from gctd3.files import new_file

SOURCE = Path(__file__).with_name("gazebo.cpp")
LIBRARY = "ignition-physics5"  # its name for pkg-config
APT = "apt-get install g++ pkg-config libignition-physics-dev"  # Debian 12
_PARTS = (f"{LIBRARY}-sdf", "ignition-plugin1-loader", "sdformat12")
_FLAGS = ("-std=c++17", "-O2")


def check_library() -> None:
    """Raise a :class:`ConfigError` that says what to install unless compiler, library and engine are there."""
    missing = [name for name in ("g++", "pkg-config") if shutil.which(name) is None]
    if "pkg-config" not in missing and not (_knows(*_PARTS) and plugin().is_file()):
        missing.append(f"Gazebo's physics library ({LIBRARY})")
    if missing:
        raise ConfigError(f"engine=gazebo needs {', '.join(missing)}; Debian 12 has them: {APT}.")


def library_version() -> str:
    """Return the version of Gazebo's physics library.

    Raises:
        EngineError: If pkg-config does not know the library; so do :func:`plugin` and :func:`program`.
    """
    return _ask("--modversion", LIBRARY)


def plugin() -> Path:
    """Return the place of the engine, DART, as a plug-in of the library."""
    folder = Path(_ask("--variable=libdir", LIBRARY), "ign-physics-5", "engine-plugins")
    return folder / f"lib{LIBRARY}-dartsim-plugin.so"


def program(folder: Path) -> Path:
    """Return the compiled program: from the user's cache, in which it is put if it is not there.

    Args:
        folder: Folder that takes its place where the user has no cache that is theirs alone.

    Raises:
        EngineError: If it cannot be compiled.
    """
    known = [SOURCE.read_text(encoding="utf-8"), *_FLAGS, platform.machine(), _version("g++")]
    known += [_ask("--modversion", part) for part in (LIBRARY, *_PARTS)]
    name = f"gazebo-{hashlib.sha256(repr(known).encode()).hexdigest()[:16]}"
    cache = _cache()
    made = (cache or folder) / name
    if not _own(made):
        with new_file(made) as aside:
            _compile(aside)
    return made


def _compile(to: Path) -> None:
    libraries = shlex.split(_ask("--cflags", "--libs", *_PARTS))
    done = subprocess.run(
        ["g++", *_FLAGS, "-o", str(to), str(SOURCE), *libraries],
        capture_output=True,
        text=True,
        errors="replace",
        env={**os.environ, "LC_ALL": "C"},
    )
    if done.returncode:
        lines = done.stderr.splitlines()
        said = [line for line in lines if "error" in line] or lines[-1:] or [f"exit code {done.returncode}"]
        raise EngineError(f"g++ cannot compile {SOURCE.name} with {LIBRARY} {library_version()}: {said[0].strip()}")
    to.chmod(0o700)


def _cache() -> Path | None:
    """Return the user's folder for compiled programs, made if it is not there; ``None`` if others can write to it."""
    folder = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"), "gctd3")
    if not folder.is_absolute():
        return None
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError:
        return None
    return folder if _own(folder) and os.access(folder, os.W_OK) else None


def _own(path: Path) -> bool:
    """Return whether a file or folder is there, is the user's own and can be written by nobody else."""
    try:
        status = path.lstat()
    except OSError:
        return False
    regular = stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)
    return regular and status.st_uid == os.getuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _knows(*parts: str) -> bool:
    return subprocess.run(["pkg-config", "--exists", *parts], capture_output=True).returncode == 0


def _version(command: str) -> str:
    return subprocess.run([command, "--version"], capture_output=True, text=True).stdout


def _ask(*arguments: str) -> str:
    asked = subprocess.run(["pkg-config", *arguments], capture_output=True, text=True)
    if asked.returncode:
        raise EngineError(f"pkg-config {' '.join(arguments)}: {' '.join(asked.stderr.split())}")
    return asked.stdout.strip()
