"""Settings of the export."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from gctd3.errors import ConfigError, check_between, check_seed

NEEDED = ("onnx", "onnxscript", "onnxruntime")
MOST_RATE = 100.0  # rad/s


@dataclass(frozen=True)
class ExportSettings:
    """Hold the settings of ``gctd3.export``.

    Attributes:
        run: Directory of the run; ``None`` for the walking biped that ships with gctd3.
        out: File to write. ``.onnx``: an ONNX file, and its contract as .json beside it; ``.pt2``: a file of
            torch.export with the contract inside; ``.hpp``: a C++17 header with the contract inside.
        max_rate: Largest rate at which a desired joint angle may change on the robot (rad/s); ``None`` for 1.2 times
            the largest change in a control step that the policy asks of each servo in simulation.
        hold: Time for which a robot without good readings holds its last command before it goes to its home pose (s).
        home_rate: Rate at which each joint goes to the home pose, before a walk and without good readings (rad/s).
        episodes: Number of episodes of that simulation, which also visits the states of the comparison with PyTorch.
        seed: Seed of the episodes' starts.
        threads: CPU threads of the simulation; ``None`` for all cores. Results do not depend on it.
    """

    run: str | None = None
    out: str = "policy.onnx"
    max_rate: float | None = None
    hold: float = 0.1
    home_rate: float = 0.5
    episodes: int = 10
    seed: int = 10_000
    threads: int | None = None

    def __post_init__(self) -> None:
        check_between(self, 1, 10_000, "episodes")
        check_seed("seed", self.seed)
        check_between(self, 0.0, 10.0, "hold")
        if not 0 < self.home_rate <= MOST_RATE:
            raise ConfigError(f"home_rate must be above 0 and at most {MOST_RATE:g} rad/s, got {self.home_rate}.")
        if self.max_rate is not None and not self.max_rate > 0:
            raise ConfigError(f"max_rate must be above 0 rad/s, or null, got {self.max_rate}.")
        file = Path(self.out)
        if file.suffix not in (".onnx", ".pt2", ".hpp"):
            raise ConfigError(f"out must end in .onnx, .pt2 or .hpp, got {self.out!r}.")
        if not file.absolute().parent.is_dir():
            raise ConfigError(f"out={self.out}: there is no folder {file.absolute().parent}.")
        missing = [package for package in NEEDED if find_spec(package) is None]
        if missing and file.suffix != ".pt2":
            raise ConfigError(f"To export to {file.suffix} needs {', '.join(missing)}: pip install 'gctd3[export]'.")
