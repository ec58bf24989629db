"""Choosing how MuJoCo draws. Import this before MuJoCo."""

from __future__ import annotations

import ctypes
import os
import sys

from gctd3.errors import RenderError

# Library to look for, value of MUJOCO_GL, Debian package.
_HEADLESS = (("libEGL.so.1", "egl", "libegl1"), ("libOSMesa.so.8", "osmesa", "libosmesa6"))


def choose_backend() -> str:
    """Set ``MUJOCO_GL`` unless it is set: the screen if there is one, else EGL, else OSMesa.

    Returns:
        Its value.

    Raises:
        RenderError: If this Linux has no screen and neither library.
    """
    chosen = os.environ.get("MUJOCO_GL")
    if chosen or not sys.platform.startswith("linux") or os.environ.get("DISPLAY"):
        return chosen or "glfw"
    for library, backend, _ in _HEADLESS:
        try:
            ctypes.CDLL(library)
        except OSError:
            continue
        os.environ["MUJOCO_GL"] = backend
        return backend
    packages = " or ".join(package for _, _, package in _HEADLESS)
    raise RenderError(f"No screen and no headless OpenGL was found: install {packages} (Debian's names).")
