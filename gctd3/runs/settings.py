"""Settings of the commands that take a finished run: to evaluate, render and view it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path

from gctd3.errors import ConfigError, check_between, check_seed
from gctd3.evaluation.settings import CommandGrid, EpisodeSettings, Perturbations
from gctd3.tasks.reward import Reward
from gctd3.viz.hosts import HOST

MOST_PIXELS = 16_384  # of a frame's side


@dataclass(frozen=True)
class EvaluateSettings(EpisodeSettings):
    """Hold the settings of ``gctd3.evaluate``.

    Attributes:
        run: Directory of the run; ``None`` for the walking biped that ships with gctd3.
        reward: Reward under which to evaluate; ``None`` for the one under which training evaluated, which is the
            paper's by default.
        out: Directory for evaluation.json and trace.csv; ``None`` for the run's, and nothing is written if no run is
            given.
        robustness: Test robustness too: to pushes, other masses and floors, delayed actions, noise.
        perturbations: Perturbations of the robustness test, and their magnitudes.
        commands: Test a policy of task=velocity with a grid of commanded velocities too, one held in each episode.
        grid: The grid.
        bag: File for a bag of the typical episode, with pip install 'gctd3[bags]'. ``.bag``: of ROS 1; ``.mcap``: of
            ROS 2. ``None`` for none.
    """

    run: str | None = None
    reward: Reward | None = None
    out: str | None = None
    robustness: bool = False
    perturbations: Perturbations = field(default_factory=Perturbations)
    commands: bool = False
    grid: CommandGrid = field(default_factory=CommandGrid)
    bag: str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.bag is None:
            return
        if Path(self.bag).suffix not in (".bag", ".mcap"):
            raise ConfigError(f"bag must end in .bag (ROS 1) or .mcap (ROS 2), got {self.bag!r}.")
        folder = Path(self.bag).absolute().parent
        if not folder.is_dir():
            raise ConfigError(f"bag={self.bag}: there is no folder {folder}.")
        if find_spec("rosbags") is None:
            raise ConfigError("A bag needs rosbags: pip install 'gctd3[bags]'.")

    @property
    def folder(self) -> Path | None:
        """Return the directory to write to; ``None`` to write nothing."""
        place = self.run if self.out is None else self.out
        return Path(place) if place is not None else None


@dataclass(frozen=True)
class RenderSettings:
    """Hold the settings of ``gctd3.render``.

    Attributes:
        run: Directory of the run; ``None`` for the walking biped that ships with gctd3.
        out: File to write. ``.png``: a sheet of frames; ``.gif``: an animation; ``.mp4``: a video, with pip install
            'gctd3[video]'.
        seed: Seed of the start.
        camera: ``side`` or ``three_quarter``, or a camera of the robot's MJCF.
        width: Width of a frame (pixels).
        height: Height of a frame (pixels).
        columns: Columns of the sheet.
        rows: Rows of the sheet.
        every: Control steps between the sheet's frames.
        begin: Distance past the start at which the sheet begins (m).
        speed: Speed of the animation, as a multiple of real time.
        seconds: Time of the walk that the animation shows, from the start (s); ``None`` for all of it.
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
    """Hold the settings of ``gctd3.view``.

    Attributes:
        run: Directory of the run; ``None`` for the walking biped that ships with gctd3.
        runs: Directory below which there are more runs to choose from, in the browser.
        seed: Seed of the first start; each further start has the next seed.
        endless: ``True``: only a fall ends the walk; ``False``: the finish, the time limit and the paper's endings do
            too.
        host: Address to listen at; 0.0.0.0 for every machine that can reach this one: whoever can see it can steer it.
        port: Port to listen at; 0 for any that is free.
        allowed_hosts: Further names under which browsers reach the viewer, as that of a proxy: ``name`` with any port,
            or ``name:port``. Without, it answers to localhost, 127.0.0.1, [::1], ``host`` and this machine's address,
            each with ``port``, and refuses pages of other sites.
        browser: Open the page in a browser here, where there is a screen.
    """

    run: str | None = None
    runs: str = "runs"
    seed: int = 10_000
    endless: bool = True
    host: str = "localhost"
    port: int = 8080
    allowed_hosts: Sequence[str] = ()
    browser: bool = True

    def __post_init__(self) -> None:
        check_seed("seed", self.seed)
        check_between(self, 0, 65_535, "port")
        for name in self.allowed_hosts:
            if not HOST.fullmatch(name):
                raise ConfigError(f"allowed_hosts must hold names as example.org or example.org:8080, got {name!r}.")
