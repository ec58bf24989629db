"""Draw a policy's walk: ``python -m gctd3.render run=DIR out=walk.mp4``."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gctd3.errors import ConfigError, check_between, check_seed
from gctd3.files import new_file
from gctd3.runs.load import load_run
from gctd3.viz.film import check_camera, check_video, draw, record, sheet, stride, write_animation
from gctd3.viz.offscreen import find_backend

MOST_PIXELS = 16_384  # of a frame's side


@dataclass(frozen=True)
class RenderSettings:
    """What ``gctd3.render`` is asked to do.

    Attributes:
        run: Directory of the run; the policy that ships with the library if ``None``.
        out: ``.png`` for a sheet of frames, ``.gif`` or ``.mp4`` for an animation.
        seed: Of the start.
        camera: Of the MJCF, or ``side`` or ``three_quarter``.
        width: Of a frame (pixels).
        height: Of a frame (pixels).
        columns: Of the sheet.
        rows: Of the sheet.
        every: Control steps between the sheet's frames.
        begin: Distance at which the sheet begins (m), past the start.
        speed: Of the animation, as a multiple of real time.
        seconds: Of the walk that the animation shows, from the start; ``None`` for all of it.
    """

    run: str | None
    out: str
    seed: int = 10_000
    camera: str = "side"
    width: int = 320
    height: int = 320
    columns: int = 6
    rows: int = 2
    every: int = 3
    begin: float = 7.0
    speed: float = 1.0
    seconds: float | None = None

    def __post_init__(self) -> None:
        check_between(self, 1, MOST_PIXELS, "width", "height")
        check_between(self, 1, 1000, "columns", "rows", "every")
        check_seed("seed", self.seed)
        check_between(self, 0.01, 100, "speed")
        if self.seconds is not None and not self.seconds > 0:
            raise ConfigError(f"seconds must be above 0, or null, got {self.seconds}.")
        if Path(self.out).suffix not in (".png", ".gif", ".mp4"):
            raise ConfigError(f"out must end in .png, .gif or .mp4, got {self.out!r}.")
        folder = Path(self.out).absolute().parent
        if not folder.is_dir():
            raise ConfigError(f"out={self.out}: there is no folder {folder}.")


def render_run(settings: RenderSettings) -> Path:
    """Draw the best policy of a run.

    Returns:
        The file written.

    Raises:
        RunError: If it is no run, or not of the walking task.
        RenderError: If there is nothing to draw with, or no package for videos.
    """
    run, out = load_run(settings.run), Path(settings.out)
    task = run.task("film")
    policy, robot = run.policy(), task.robot
    # All that could be missing, before the walk.
    check_camera(robot, settings.camera)
    find_backend()
    if out.suffix == ".mp4":
        check_video()
    dt, size = task.control_dt, (settings.width, settings.height)
    if out.suffix != ".png":
        most = None if settings.seconds is None else max(1, round(settings.seconds / dt))
        walk = record(policy, task, settings.seed, most)
        every = stride(settings.speed, dt)
        frames = draw(walk, robot, np.arange(0, len(walk.qpos), every), settings.camera, size, dt)
        write_animation(out, frames, settings.speed / (every * dt))
        return out
    walk = record(policy, task, settings.seed)
    first = int(np.argmax(walk.position >= min(settings.begin, walk.position[-1] / 2)))
    steps = first + settings.every * np.arange(settings.columns * settings.rows)
    page = sheet(list(draw(walk, robot, steps[steps < len(walk.qpos)], settings.camera, size, dt)), settings.columns)
    with new_file(out) as aside, aside.open("wb") as file:
        page.save(file, format="PNG")
        os.fsync(file.fileno())
    return out
