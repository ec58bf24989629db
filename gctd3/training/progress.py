"""The progress of a training: what is counted, and the line that shows it."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from types import TracebackType

from tqdm import tqdm

from gctd3.progress import QUIET_SECONDS

# In this order, so that a terminal of 80 columns shows all numbers and leaves out the bar.
_LINE = "{percentage:3.0f}% {n_fmt}/{total_fmt} frames {rate_noinv_fmt} {remaining} left{postfix} {bar}"


@dataclass
class Counters:
    """Count the progress of a training.

    Attributes:
        frames: Control steps of single robots so far.
        updates: Updates of the networks.
        episodes: Episodes that ended.
        diverged: Episodes that ended because the simulation did not stay finite.
        in_a_row: Evaluations in a row that met all conditions.
        restarts: Times that the training began again with new weights.
        promising: Frames at which the training began (again), or at which an evaluation last met all conditions.
        next_evaluation: Frames at which the next evaluation is due.
        wall_s: Seconds spent, before and after every resumption together.
    """

    frames: int = 0
    updates: int = 0
    episodes: int = 0
    diverged: int = 0
    in_a_row: int = 0
    restarts: int = 0
    promising: int = 0
    next_evaluation: int = 0
    wall_s: float = 0.0


class ProgressLine:
    """Show how far a training is: a line that is drawn over on a terminal, and lines below one another elsewhere.

    Args:
        total: Frames that the training may collect.
        frames: Frames collected before.
    """

    def __init__(self, total: int, frames: int) -> None:
        self._total, self._frames, self._before = total, frames, frames
        self._began = self._told = time.monotonic()
        self._bar: tqdm[None] | None = None
        if sys.stderr.isatty():
            shown = {"bar_format": _LINE, "unit": "", "unit_scale": True, "smoothing": 0.05, "mininterval": 0.5}
            self._bar = tqdm(total=total, initial=frames, dynamic_ncols=True, **shown)

    def __enter__(self) -> ProgressLine:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.close()

    def advance(self, frames: int) -> None:
        """Count collected frames."""
        self._frames += frames
        if self._bar is not None:
            self._bar.update(frames)
        elif time.monotonic() - self._told >= QUIET_SECONDS:
            self._tell("")

    def evaluated(self, figures: Mapping[str, str]) -> None:
        """Show the figures of the last evaluation."""
        text = " ".join(f"{name} {value}" for name, value in figures.items())
        if self._bar is not None:
            self._bar.set_postfix_str(text, refresh=True)
        else:
            self._tell(f", {text}")

    def write(self, text: str) -> None:
        """Print a line that stays."""
        tqdm.write(text)

    def _tell(self, rest: str) -> None:
        self._told = time.monotonic()
        rate = (self._frames - self._before) / max(self._told - self._began, 1e-9)
        print(f"{self._frames:,} of {self._total:,} frames, {rate:,.0f}/s{rest}", file=sys.stderr, flush=True)
