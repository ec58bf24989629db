"""Write the copy of its robot that a run keeps; :mod:`.own_copy` says what it consists of, and reads it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

import gctd3
from gctd3.errors import RunError
from gctd3.files import MANIFEST, OWN_MJCF, OWN_ROBOT, checksum, new_directory, write_manifest
from gctd3.robots.physics import combined, part_hashes
from gctd3.robots.robot import Robot
from gctd3.robots.sources import Source

if TYPE_CHECKING:
    from gctd3.robots.portable import Portable

NUMBERS = "numbers.npz"
FORMAT = 1
# Numbers that are not kept: MuJoCo makes them of files that are, or they only show the robot.
_REMADE = ("mesh_", "hfield_", "skin_", "tex_", "bvh_", "oct_", "flexedge_", "mat_", "light_", "cam_")
_FLAGS = ("body_sameframe", "geom_sameframe", "site_sameframe")


def keep_robot(robot: Robot, run: Path) -> None:
    """Write a robot as a run's own copy; of a robot that another library brings only its hash.

    Args:
        robot: The robot, as it was loaded.
        run: Directory of the run.

    Raises:
        RunError: If something else is in its place.
        OSError: If it cannot be written.
    """
    folder = run / OWN_ROBOT
    if has_robot(run):
        shutil.rmtree(folder)  # of a training that was broken off before it had anything to continue
    elif folder.exists():
        raise RunError(f"{folder} is in the place of a run's own copy of its robot: choose another hydra.run.dir.")
    parts, portable = part_hashes(robot.model), robot.written.portable() if robot.written is not None else None
    source = robot.source
    content: dict[str, Any] = {
        "format": FORMAT,
        "name": robot.path.stem,
        "hash": combined(parts),
        "parts": parts,
        "versions": {"gctd3": gctd3.__version__, "mujoco": mujoco.__version__},
        "source": None if source is None else _source(source),
        "robot": {
            "path": str(robot.path) if source is None else _path(source),
            "root": robot.root,
            "feet": list(robot.feet),
            "forward_axis": robot.forward_axis,
            "action_scale": robot.action_scale,
            "standing_command": robot.standing_command,
            "notes": list(robot.notes),
            "held": dict(robot.held),
        },
        "files": {},
        "left_out": [],
    }
    with new_directory(folder) as aside:
        if portable is not None:
            _write(robot.model, portable, aside)
            content["files"] = {file.name: checksum(file) for file in sorted(aside.iterdir())}
            content["left_out"] = [
                {"file": str(file), "sha256": checksum(file)} for file in portable.left_out if file.is_file()
            ]
        write_manifest(aside, content)


def _source(source: Source) -> dict[str, Any]:
    about = {key: value for key, value in asdict(source).items() if key != "recorded"}
    return {**about, "file": _path(source), "sha256": source.sha256}


def _path(source: Source) -> str:
    """Return where the file was; of one that ships with the library only its name, for it is found by that."""
    return source.file.name if source.ships else str(source.file.absolute())


def _write(model: mujoco.MjModel, portable: Portable, folder: Path) -> None:
    (folder / OWN_MJCF).write_text(portable.mjcf, encoding="utf-8")
    for name, file in portable.assets.items():
        shutil.copyfile(file, folder / name)
    kept = np.array(portable.geoms, dtype=np.int64)
    kept_numbers = {
        name: values[kept] if name.startswith("geom_") else values for name, values in numbers(model) if values.size
    }
    with (folder / NUMBERS).open("wb") as opened:
        np.savez_compressed(opened, **kept_numbers)  # type: ignore[arg-type]


def numbers(model: mujoco.MjModel) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the model's numbers by name, those of its options and statistics too."""
    for prefix, owner in (("", model), ("opt.", model.opt), ("stat.", model.stat)):
        for name in dir(owner):
            if name.startswith(("_", *_REMADE)):
                continue
            value = getattr(owner, name, None)
            if isinstance(value, float) or (isinstance(value, np.ndarray) and value.dtype.kind == "f"):
                yield f"{prefix}{name}", np.asarray(value)
            elif name in _FLAGS:
                yield name, np.asarray(value)


def has_robot(run: Path) -> bool:
    """Tell whether a run has a copy of its robot, or at least the hash of it."""
    return (run / OWN_ROBOT / MANIFEST).is_file()
