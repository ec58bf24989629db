"""A stride of each group's typical policy in pictures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image

from gctd3.checkpoint import load_policy
from gctd3.envs.library import LibrarySettings
from gctd3.errors import GCTD3Error, RenderError
from gctd3.film import draw, record, sheet
from gctd3.reporting.runs import Run
from gctd3.robot import Robot
from gctd3.run_config import load_settings

COLUMNS, ROWS = 4, 2
SIZE = 220  # pixels of a frame's side
SEED = 10_000  # of the start, as in evaluations
BEGIN = 7.0  # m, where gaits have settled
STRIDE = 0.7  # s, of a gait that has none


def median(runs: Sequence[Run]) -> Run | None:
    """Of the runs that were judged the one whose return is the median one, or just below."""
    known = sorted((run for run in runs if run.evaluation), key=lambda run: run.value("return_mean"))
    return known[(len(known) - 1) // 2] if known else None


def filmstrip(run: Run, robot: Robot, camera: str = "side") -> Image.Image:
    """One stride of a run's policy past the first metres, in equal steps of time.

    Raises:
        RenderError: If it cannot be drawn, whatever the reason.
    """
    try:
        env = load_settings(run.directory).env
        if isinstance(env, LibrarySettings):
            raise RenderError("only the walking task can be drawn")
        walk = record(load_policy(run.directory), robot, env, SEED)
        stride = run.value("stride_time")
        steps = (stride if np.isfinite(stride) else STRIDE) / env.control_dt
        first = int(np.argmax(walk.position >= min(BEGIN, walk.position[-1] / 2)))
        chosen = first + np.round(steps * np.arange(COLUMNS * ROWS) / (COLUMNS * ROWS)).astype(int)
        chosen = chosen[chosen < len(walk.qpos)]
        return sheet(list(draw(walk, robot, chosen, camera, (SIZE, SIZE), env.control_dt)), COLUMNS)
    except GCTD3Error as error:
        raise RenderError(str(error)) from error
