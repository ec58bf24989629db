"""Draw a policy's walk: ``python -m gctd3.render run=DIR out=walk.mp4``."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from gctd3.files import check_writable, new_file
from gctd3.progress import tracked
from gctd3.runs.load import load_run
from gctd3.runs.settings import RenderSettings
from gctd3.viz.film import check_camera, check_video, draw, record, sheet, stride, write_animation
from gctd3.viz.offscreen import find_backend


def render_run(settings: RenderSettings) -> Path:
    """Render the walk of the best policy of a run: a sheet of frames, an animation or a video.

    Returns:
        The file written.

    Raises:
        RunError: If it is no run, or not of the walking task.
        RenderError: If there is nothing to draw with, or no package for videos.
    """
    run, out = load_run(settings.run), Path(settings.out)
    task = run.task("film")
    policy, robot = run.policy(), task.stage
    # Check all requirements before the walk.
    check_writable(out)
    check_camera(robot, settings.camera)
    find_backend()
    if out.suffix == ".mp4":
        check_video()
    dt, size = task.control_dt, (settings.width, settings.height)
    if out.suffix != ".png":
        most = None if settings.seconds is None else max(1, round(settings.seconds / dt))
        walk = record(policy, task, settings.seed, most)
        every = stride(settings.speed, dt)
        steps = np.arange(0, len(walk.qpos), every)
        frames = tracked(draw(walk, robot, steps, settings.camera, size, dt), "drawing pictures", len(steps))
        write_animation(out, frames, settings.speed / (every * dt))
        return out
    walk = record(policy, task, settings.seed)
    first = int(np.argmax(walk.position >= min(settings.begin, walk.position[-1] / 2)))
    steps = first + settings.every * np.arange(settings.columns * settings.rows)
    steps = steps[steps < len(walk.qpos)]
    pictures = draw(walk, robot, steps, settings.camera, size, dt)
    page = sheet(list(tracked(pictures, "drawing pictures", len(steps))), settings.columns)
    with new_file(out) as aside, aside.open("wb") as file:
        page.save(file, format="PNG")
        os.fsync(file.fileno())
    return out
