"""Filmstrips: a stride of each group's typical policy in pictures."""

from __future__ import annotations

import numpy as np
from PIL import Image

from gctd3.comparison.runs import Run
from gctd3.errors import GCTD3Error, RenderError
from gctd3.runs.load import load_run
from gctd3.training.checkpoint import FOLDER
from gctd3.viz.film import draw, record

FRAMES = 8
SIZE = 256  # pixels of a frame's side
SEED = 10_000  # of the start, as in evaluations
BEGIN = 7.0  # m, where gaits have settled
STRIDE = 0.7  # s, for a gait whose stride time is not known


def stride_of(run: Run, camera: str = "side") -> tuple[list[tuple[Image.Image, str]], str, str]:
    """Draw one stride of a run's policy past the first metres, in equal steps of time.

    Returns:
        The pictures with the time and place of each, their subject, and a caption.

    Raises:
        RenderError: If the stride cannot be drawn.
    """
    if not (run.directory / FOLDER).is_dir():
        raise RenderError(f"{run.name} has numbers only, no policy.")
    try:
        loaded = load_run(run.directory)
        task = loaded.task("film")
        walk = record(loaded.policy(), task, SEED)
        time = run.value("stride_time")
        strides = bool(np.isfinite(time))
        steps = (time if strides else STRIDE) / task.control_dt
        first = int(np.argmax(walk.position >= min(BEGIN, walk.position[-1] / 2)))
        chosen = first + np.round(steps * np.arange(FRAMES) / FRAMES).astype(int)
        chosen = chosen[chosen < len(walk.qpos)]
        images = list(draw(walk, task.stage, chosen, camera, (SIZE, SIZE), task.control_dt, words=False))
    except GCTD3Error as error:
        raise RenderError(str(error)) from error
    what = "a stride" if strides else f"{STRIDE} s, its stride time being unknown"
    words = [f"{(step + 1) * task.control_dt:.2f} s, {walk.position[step]:.2f} m" for step in chosen]
    caption = "The policy with the group's median return, in equal steps of time; a line on the floor every metre."
    return list(zip(images, words, strict=True)), what, caption
