"""Settings of the check of a policy in another engine."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from gctd3.engines.gazebo_program import check_library, library_version
from gctd3.errors import ConfigError, check_between, check_seed

PACKAGES = {"dart": "dartpy", "bullet": "pybullet"}
TITLES = {"dart": "DART", "bullet": "Bullet", "gazebo": "Gazebo's library"}


@dataclass(frozen=True)
class CrossCheckSettings:
    """Hold the settings of ``gctd3.crosscheck``.

    Attributes:
        run: Directory of the run; ``None`` for the walking biped that ships with gctd3.
        policy: Its policy as gctd3.export wrote it, an .onnx file; ``None`` to export it anew, to nowhere.
        engine: The other engine, beside which MuJoCo runs the same starts: ``dart``, ``bullet`` or ``gazebo``.
        episodes: Number of randomised starts.
        seed: Seed of the starts.
        timestep: Time step of the other engine (s); a control period must be a multiple of it.
        armature: Add the joints' armature, which other engines do not know, to the inertia of the links below; without
            it stiff servos explode.
        tolerance: Largest difference from MuJoCo in the share of finishes, and in speed as a share of MuJoCo's.
        out: File for the numbers, .json; ``None`` to print the table alone.
        threads: CPU threads of the export's simulation; ``None`` for all cores.
    """

    run: str | None = None
    policy: str | None = None
    engine: Literal["dart", "bullet", "gazebo"] = "dart"
    episodes: int = 50
    seed: int = 10_000
    timestep: float = 0.001
    armature: bool = True
    tolerance: float = 0.1
    out: str | None = None
    threads: int | None = None

    def __post_init__(self) -> None:
        check_between(self, 1, 10_000, "episodes")
        check_seed("seed", self.seed)
        check_between(self, 1e-5, 0.05, "timestep")
        check_between(self, 0.0, 1.0, "tolerance")
        for key, suffix in (("policy", ".onnx"), ("out", ".json")):
            value = getattr(self, key)
            if value is not None and Path(value).suffix != suffix:
                raise ConfigError(f"{key} must be a {suffix} file, or null, got {value!r}.")
        if self.out is not None and not Path(self.out).absolute().parent.is_dir():
            raise ConfigError(f"out={self.out}: there is no folder {Path(self.out).absolute().parent}.")
        package = PACKAGES.get(self.engine)
        if package is None:
            check_library()
        elif find_spec(package) is None:
            raise ConfigError(f"engine={self.engine} needs {package}: pip install 'gctd3[engines]'.")
        wanted = ("onnxruntime",) if self.policy is not None else ("onnx", "onnxscript", "onnxruntime")
        missing = [name for name in wanted if find_spec(name) is None]
        if missing:
            raise ConfigError(f"The exported policy needs {', '.join(missing)}: pip install 'gctd3[export]'.")


def engine_version(engine: str) -> dict[str, str]:
    """Return the version of an engine, by the name of its package."""
    package = PACKAGES.get(engine)
    return {"ignition-physics": library_version()} if package is None else {package: version(package)}
