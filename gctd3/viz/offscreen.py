"""Drawing without a screen: which OpenGL works here, and a canvas that MuJoCo draws on with it."""

from __future__ import annotations

import functools
import logging
import os
import platform
import subprocess
import sys
from importlib import import_module
from types import TracebackType
from typing import Any

import mujoco
import numpy as np

from gctd3.errors import RenderError
from gctd3.viz.scenery import has_sky, paint_sky, with_scenery

CHOICE = "MUJOCO_GL"  # the environment variable with which MuJoCo lets its users choose
# Backends by system, the best first: EGL of a GPU or of Mesa, Mesa's software renderer, the screen's.
BACKENDS = {"Linux": ("egl", "osmesa", "glfw"), "Darwin": ("cgl", "glfw"), "Windows": ("glfw",)}
HOW = (
    "Debian and Ubuntu bring one with `apt install libegl1` (or libosmesa6), Fedora with "
    "`dnf install mesa-libEGL` (or mesa-libOSMesa)."
)
_MOST_GEOMS = 10_000
_SHADOW = 1024  # pixels of the shadow map; the shipped MJCFs' 4096 are much for a renderer in software
_FAR = 1.0  # in the depth buffer, where nothing was drawn
# OpenGL's library can be chosen only once in a process, so each is tried in one of its own.
_TRY = """
import sys
from importlib import import_module
import mujoco
context = import_module(f"mujoco.{sys.argv[1]}").GLContext(16, 16)
context.make_current()
mujoco.MjrContext(mujoco.MjModel.from_xml_string("<mujoco/>"), mujoco.mjtFontScale.mjFONTSCALE_100).free()
context.free()
"""


@functools.cache
def find_backend() -> str:
    """Find the backend to draw with: the one that ``MUJOCO_GL`` names, else the first that works.

    Raises:
        RenderError: If no backend works; the message names the packages to install.
    """
    known = BACKENDS.get(platform.system(), ("glfw",))
    chosen = os.environ.get(CHOICE, "").lower().strip()
    if chosen and chosen not in known:
        raise RenderError(f"{CHOICE} must be one of {', '.join(known)} here, or not be set; got {chosen!r}.")
    failures = []
    for name in [chosen] if chosen else known:
        tried = subprocess.run([sys.executable, "-W", "ignore", "-c", _TRY, name], capture_output=True, text=True)
        if tried.returncode == 0:
            return name
        lines = tried.stderr.strip().splitlines() or [f"it ended with {tried.returncode}"]
        failures.append(f"{name}: {lines[-1]}")
    wanted = f" {CHOICE}={chosen} allows no other." if chosen else ""
    raise RenderError(f"There is no OpenGL to draw with.{wanted} {HOW} Tried\n  " + "\n  ".join(failures))


class Canvas:
    """Render a model offscreen with MuJoCo, with the scenery that it lacks.

    A context manager; only for the thread that made it.

    Args:
        model: The model.
        width: Width of the picture (pixels).
        height: Height of the picture (pixels).

    Raises:
        RenderError: If no OpenGL backend works, or the picture is too large for it.
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        backend = find_backend()
        model = with_scenery(model)
        self.model, self.width, self.height, self._sky = model, width, height, has_sky(model)
        model.vis.global_.offwidth, model.vis.global_.offheight = width, height
        model.vis.quality.shadowsize = min(model.vis.quality.shadowsize, _SHADOW)
        self.scene = mujoco.MjvScene(model, maxgeom=_MOST_GEOMS)
        self._options = mujoco.MjvOption()
        self._area = mujoco.MjrRect(0, 0, width, height)
        # PyOpenGL reports that its optional C extension is not there.
        logging.getLogger("OpenGL.acceleratesupport").setLevel(logging.WARNING)
        self._gl: Any = import_module(f"mujoco.{backend}").GLContext(width, height)
        self._gl.make_current()
        try:
            self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        except mujoco.FatalError as error:
            self._gl.free()
            raise RenderError(f"{backend} cannot draw {width} x {height} pixels: {error}.") from error
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)

    def __enter__(self) -> Canvas:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._context.free()
        self._gl.free()

    def look(self, data: mujoco.MjData, camera: mujoco.MjvCamera) -> None:
        """Set up :attr:`scene` as a camera sees it; more geoms may be added to it then."""
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(self.model, data, self._options, None, camera, everything, self.scene)

    def draw(self) -> np.ndarray:
        """Render the picture of :attr:`scene`, shape ``[height, width, 3]``, 0 to 255."""
        self._gl.make_current()
        pixels = np.empty((self.height, self.width, 3), np.uint8)
        depth = None if self._sky else np.empty((self.height, self.width), np.float32)
        mujoco.mjr_render(self._area, self.scene, self._context)
        mujoco.mjr_readPixels(pixels, depth, self._area, self._context)
        # OpenGL's rows go upwards.
        pixels = np.ascontiguousarray(pixels[::-1])
        if depth is not None:
            paint_sky(pixels, depth[::-1] == _FAR)
        return pixels
