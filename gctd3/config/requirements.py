"""Packages that gctd3 needs: what to do where one is missing or cannot be imported. Light."""

from __future__ import annotations

import sys
import warnings
from importlib import import_module
from importlib.metadata import PackageNotFoundError, requires, version
from importlib.util import find_spec
from traceback import walk_tb

from gctd3.errors import PackageError, one_line

# dm_control needs labmaze, which has wheels up to this Python.
NEWEST_PYTHON_OF_DM_CONTROL = (3, 12)


def requirement(package: str) -> str:
    """Return what gctd3 requires of a package on this Python, such as ``mujoco<4,>=3.17``; else the bare name."""
    from packaging.requirements import Requirement

    try:
        declared = [Requirement(line) for line in requires("gctd3") or ()]
    except PackageNotFoundError:
        declared = []
    for wanted in declared:
        if wanted.name == package and (wanted.marker is None or wanted.marker.evaluate({"extra": ""})):
            return f"{wanted.name}{wanted.specifier}"
    return package


def check_dm_control(what: str) -> None:
    """Raise a :class:`.PackageError` unless dm_control can be imported.

    Args:
        what: Name of what needs it, to begin the error with.
    """
    if find_spec("dm_control") is None:
        newest = ".".join(map(str, NEWEST_PYTHON_OF_DM_CONTROL))
        here = ".".join(map(str, sys.version_info[:2]))
        cure = f"it is available up to Python {newest}, and this is {here}"
        if sys.version_info[:2] <= NEWEST_PYTHON_OF_DM_CONTROL:
            cure = f"pip install '{requirement('dm-control')}' '{requirement('mujoco')}'"
        raise PackageError(f"{what} needs dm_control, which is not installed: {cure}.")
    try:
        with warnings.catch_warnings():
            # Without a display GLFW only warns, and dm_control settles on it; an error sends it on to EGL, then OSMesa.
            warnings.filterwarnings("error", module="glfw")
            import_module("dm_control.mujoco")
    except Exception as error:
        if reason := why_no_mujoco(error):
            raise PackageError(reason) from error
        raise PackageError(
            f"{what} needs dm_control, and dm_control {version('dm-control')} cannot be imported with mujoco "
            f"{version('mujoco')} ({one_line(error)}): pip install 'mujoco>=3.17,<4'."
        ) from error


def why_no_mujoco(error: BaseException) -> str | None:
    """Describe an error that mujoco raised while it was imported; ``None`` for any other.

    pip upgrades mujoco 3 to 4 in place and reports success, but leaves out what the two have in common.
    """
    inside = (str(frame.f_globals.get("__name__")).split(".")[0] for frame, _ in walk_tb(error.__traceback__))
    if not isinstance(error, ImportError) or "mujoco" not in inside:
        return None
    # Not mujoco's advice, which reinstalls what pip then completes with a newer core.
    said = one_line(error.__cause__ if isinstance(error.__cause__, ImportError) else error).split(". ")[0]
    return (
        "mujoco is installed but cannot be imported, as after an upgrade from 3 to 4 in place: "
        "pip uninstall -y mujoco mujoco-core mujoco-studio, "
        f"then pip install '{requirement('mujoco')}' ({said})."
    )
