"""Settings of the commands that take a finished run: what to judge, draw and show."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from gctd3.errors import ConfigError, check_between, check_seed
from gctd3.evaluation.settings import Judging, Perturbations
from gctd3.tasks.reward import Reward

MOST_PIXELS = 16_384  # of a frame's side


@dataclass(frozen=True)
class EvaluateSettings(Judging):
    """What ``gctd3.evaluate`` is asked to do.

    Attributes:
        run: Directory of the run; the policy that ships with the library if ``None``.
        reward: Under which to judge.
        out: Directory to write to; the run's if ``None``, nowhere if there is no run either.
        robustness: Whether to push, load and disturb the robot, too.
        perturbations: By how much.
    """

    run: str | None = None
    reward: Reward = field(default_factory=Reward)
    out: str | None = None
    robustness: bool = False
    perturbations: Perturbations = field(default_factory=Perturbations)

    @property
    def folder(self) -> Path | None:
        """Where to write."""
        place = self.run if self.out is None else self.out
        return Path(place) if place is not None else None


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

    run: str | None = None
    out: str = "walk.png"
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


@dataclass(frozen=True)
class ViewSettings:
    """What ``gctd3.view`` is asked to show.

    Attributes:
        run: Directory of the run; the policy that ships with the library if ``None``.
        runs: Directory below which there are more to choose from in the browser.
        seed: Of the first start.
        endless: Whether only a fall ends the walk; otherwise the task's own endings do.
        host: Address to listen at.
        port: To listen at; 0 for any that is free.
        browser: Whether to open the page in a browser of this machine.
    """

    run: str | None = None
    runs: str = "runs"
    seed: int = 10_000
    endless: bool = True
    host: str = "localhost"
    port: int = 8080
    browser: bool = True

    def __post_init__(self) -> None:
        check_seed("seed", self.seed)
        check_between(self, 0, 65_535, "port")
