"""Settings of the export."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from gctd3.errors import ConfigError, check_between, check_seed
from gctd3.robots.settings import RobotSettings

NEEDED = ("onnx", "onnxscript", "onnxruntime")
MOST_RATE = 100.0  # rad/s
POLICIES, ROBOTS = (".onnx", ".pt2", ".hpp"), (".urdf", ".sdf")  # endings of files of a policy, and of a robot


@dataclass(frozen=True)
class ExportSettings:
    """Hold the settings of ``gctd3.export``.

    Attributes:
        run: Directory of the run; ``None`` for the walking biped that ships with gctd3.
        robot: Robot to describe without a run, for ``.urdf`` and ``.sdf``; ``None`` for the run's.
        out: File to write. ``.onnx``: an ONNX file, and its contract as .json beside it; ``.pt2``: a file of
            torch.export with the contract inside; ``.hpp``: a C++17 header with the contract inside; ``.urdf`` and
            ``.sdf``: the robot, without a policy.
        max_rate: Largest rate at which a desired joint angle may change on the robot (rad/s); ``None`` for 1.2 times
            the largest change in a control step that the policy asks of each servo in simulation.
        hold: Time for which a robot without good readings holds its last command before it goes to its home pose (s).
        home_rate: Rate at which each joint goes to the home pose, before a walk and without good readings (rad/s).
        episodes: Number of episodes of that simulation, which also visits the states of the comparison with PyTorch.
        seed: Seed of the episodes' starts.
        threads: CPU threads of the simulation; ``None`` for all cores. Results do not depend on it.
    """

    run: str | None = None
    robot: RobotSettings | None = None
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
        if file.suffix not in (*POLICIES, *ROBOTS):
            raise ConfigError(f"out must end in .onnx, .pt2, .hpp, .urdf or .sdf, got {self.out!r}.")
        if not file.absolute().parent.is_dir():
            raise ConfigError(f"out={self.out}: there is no folder {file.absolute().parent}.")
        if self.robot is not None and (self.run is not None or file.suffix in POLICIES):
            raise ConfigError(
                "robot=NAME writes a robot without a run, to out=FILE.urdf or FILE.sdf; "
                f"got out={self.out}{'' if self.run is None else f' and run={self.run}'}."
            )
        missing = [package for package in NEEDED if find_spec(package) is None]
        if missing and file.suffix in (".onnx", ".hpp"):
            raise ConfigError(f"To export to {file.suffix} needs {', '.join(missing)}: pip install 'gctd3[export]'.")
