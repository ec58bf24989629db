"""Settings of the export."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from gctd3.errors import ConfigError, check_between, check_seed

NEEDED = ("onnx", "onnxscript", "onnxruntime")


@dataclass(frozen=True)
class ExportSettings:
    """What ``gctd3.export`` is asked to do.

    Attributes:
        run: Directory of the run; the policy that ships with the library if ``None``.
        out: ``.onnx`` for an ONNX file with its contract beside it, ``.pt2`` for ``torch.export``'s with it inside.
        max_rate: Largest rate at which a desired angle may change (rad/s); ``None`` for 1.2 times what the policy asks
            of each servo in simulation.
        episodes: Of that simulation.
        seed: Of their starts.
        threads: That simulate; all cores if ``None``.
    """

    run: str | None = None
    out: str = "policy.onnx"
    max_rate: float | None = None
    episodes: int = 10
    seed: int = 10_000
    threads: int | None = None

    def __post_init__(self) -> None:
        check_between(self, 1, 10_000, "episodes")
        check_seed("seed", self.seed)
        if self.max_rate is not None and not self.max_rate > 0:
            raise ConfigError(f"max_rate must be above 0 rad/s, or null, got {self.max_rate}.")
        file = Path(self.out)
        if file.suffix not in (".onnx", ".pt2"):
            raise ConfigError(f"out must end in .onnx or .pt2, got {self.out!r}.")
        if not file.absolute().parent.is_dir():
            raise ConfigError(f"out={self.out}: there is no folder {file.absolute().parent}.")
        missing = [package for package in NEEDED if find_spec(package) is None]
        if missing and file.suffix == ".onnx":
            raise ConfigError(f"To export to .onnx needs {', '.join(missing)}: pip install 'gctd3[export]'.")
