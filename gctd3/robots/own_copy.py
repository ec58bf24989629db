"""The copy of its robot that a run keeps: the model that was completed for it, whatever becomes of its source.

* ``robot/manifest.json``: what the robot is: feet, forward axis, actions, hash, source, checksums of the other files.
* ``robot/robot.xml``: the completed model, as MuJoCo reads it; beside it colliding meshes and heightfields.
* ``robot/numbers.npz``: its numbers to the last bit, for MuJoCo writes an MJCF with six digits.
"""

from __future__ import annotations

import shutil
import sys
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

import gctd3
from gctd3.errors import RobotError, RunError
from gctd3.files import (
    MANIFEST,
    OWN_MJCF,
    OWN_ROBOT,
    check_file,
    checksum,
    new_directory,
    read_manifest,
    write_manifest,
)
from gctd3.robots.load import load_robot
from gctd3.robots.physics import combined, part_hashes, physics_hash, solid_geoms
from gctd3.robots.robot import Robot
from gctd3.robots.settings import RobotSettings
from gctd3.robots.sources import DESCRIPTION, MENAGERIE, Source, find_place, package_of

if TYPE_CHECKING:
    from gctd3.robots.portable import Portable

NUMBERS = "numbers.npz"
FORMAT = 1
# Numbers that are not kept: MuJoCo makes them of files that are, or they only show the robot.
_REMADE = ("mesh_", "hfield_", "skin_", "tex_", "bvh_", "oct_", "flexedge_", "mat_", "light_", "cam_")
_FLAGS = ("body_sameframe", "geom_sameframe", "site_sameframe")
_MARGIN = 1e-5  # m: by how much the boxes are wider in which MuJoCo looks for contacts; it only has to find them
_SHOWN = 3  # groups of geoms from this one on are not drawn
_SHORT = 12  # digits of a hash in a message


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
    numbers = {
        name: values[kept] if name.startswith("geom_") else values for name, values in _numbers(model) if values.size
    }
    with (folder / NUMBERS).open("wb") as opened:
        np.savez_compressed(opened, **numbers)  # type: ignore[arg-type]


def _numbers(model: mujoco.MjModel) -> Iterator[tuple[str, np.ndarray]]:
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


@dataclass(frozen=True)
class OwnCopy:
    """Represent the copy of its robot that a run keeps.

    Attributes:
        folder: Directory of the copy.
        content: Content of its manifest.
    """

    folder: Path
    content: Mapping[str, Any]

    @classmethod
    def read(cls, run: Path) -> OwnCopy | None:
        """Read the copy of a run; ``None`` of a run that was made before runs kept one.

        Raises:
            RunError: If it is damaged, or of a later version.
        """
        if not has_robot(run):
            return None
        folder = run / OWN_ROBOT
        content = read_manifest(folder)
        if content.get("format") != FORMAT:
            raise RunError(
                f"{folder} has format {content.get('format')!r}; gctd3 {gctd3.__version__} reads format {FORMAT}."
            )
        return cls(folder, content)

    @property
    def hash(self) -> str:
        """Return the robot's :func:`.physics_hash`."""
        return str(self.content["hash"])

    @property
    def whole(self) -> bool:
        """Return whether it is a copy, not the hash of a robot that another library brings."""
        return bool(self.content["files"])

    @property
    def present(self) -> bool:
        """Return whether it is a copy with all of its files: runs that a report keeps share one."""
        return self.whole and all((self.folder / name).is_file() for name in self.content["files"])

    @property
    def source(self) -> Source | None:
        """Return the source of the robot as it was."""
        about = self.content["source"]
        if about is None:
            return None
        recorded = {key: about[key] for key in ("place", "package", "version", "licence")}
        return Source(Path(about["file"]), recorded=about["sha256"], **recorded)

    @cached_property
    def robot(self) -> Robot:
        """Return the robot of the copy.

        Raises:
            RunError: If a file of it is missing, damaged or not what was kept.
        """
        for name, sha256 in self.content["files"].items():
            check_file(self.folder / name, sha256)
        try:
            # Not by its path, of which MuJoCo reads a backslash as the border of a folder.
            read = {name: (self.folder / name).read_bytes() for name in self.content["files"] if name != NUMBERS}
            model = mujoco.MjSpec.from_string(read.pop(OWN_MJCF).decode(), assets=read).compile()
            self._put_numbers(model)
        except (RobotError, ValueError, OSError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise RunError(f"{self.folder} cannot be read: {error}") from error
        self._check(model)
        if self.content["left_out"]:
            _show(model)
        about = self.content["robot"]
        robot = Robot.from_model(
            model,
            Path(about["path"]),
            about["feet"],
            about["forward_axis"],
            root_name=about["root"],
            driven=True,
            source=self.source,
            notes=tuple(about["notes"]),
            held=about["held"],
        )
        scale, command = (None if about[k] is None else tuple(about[k]) for k in ("action_scale", "standing_command"))
        return replace(robot, action_scale=scale, standing_command=command)

    def _put_numbers(self, model: mujoco.MjModel) -> None:
        with np.load(self.folder / NUMBERS, allow_pickle=False) as kept:
            for name, values in _numbers(model):
                if name not in kept or kept[name].shape != values.shape:
                    continue  # of another version of MuJoCo
                owner, field = model, name
                if "." in name:
                    part, _, field = name.partition(".")
                    owner = getattr(model, part)
                if values.ndim:
                    getattr(owner, field)[...] = kept[name]
                else:
                    setattr(owner, field, float(kept[name]))
        if model.nbvhstatic:
            model.bvh_aabb[: model.nbvhstatic, 3:] += _MARGIN

    def _check(self, model: mujoco.MjModel) -> None:
        wrong = _differing(self.content["parts"], part_hashes(model))
        if not wrong:
            return
        made = self.content["versions"]["mujoco"]
        if made == mujoco.__version__:
            raise RunError(f"{self.folder} is not the robot that was kept: it differs in {', '.join(wrong)}.")
        print(
            f"{self.folder}: MuJoCo {mujoco.__version__} makes another model of it than MuJoCo {made} did, which "
            f"differs in {', '.join(wrong)}.",
            file=sys.stderr,
        )

    # The source, if it is there.

    def find_source(self) -> Source | None:
        """Find the source of the robot where it was, never elsewhere; ``None`` if it is not there.

        A path is the one that was read, whatever the working directory; a package is the one that is installed.
        """
        was = self.source
        if was is None:
            return None
        downloaded = was.place.partition(":")[0] in (MENAGERIE, DESCRIPTION)
        places = [str(was.file)] if was.file.is_absolute() else []
        if was.package is not None and not downloaded and (was.ships or package_of(was.place) is not None):
            places.insert(0, was.place)
        return next((found for found in map(_there, places) if found is not None), None)

    def changes(self, settings: RobotSettings) -> str | None:
        """Describe in a line how the source differs from the copy; ``None`` if it does not, or is not there.

        Args:
            settings: Settings with which the run completed the robot.
        """
        was, source = self.source, self.find_source()
        if was is None or source is None or source.sha256 == was.sha256:
            return None
        try:
            now = load_robot(_from(settings, source))
        except RobotError as error:
            return f"The robot's source cannot be used any more, the run's own copy is: {error}"
        return self.differences(now, str(source.file), "; the run's own copy is used")

    def differences(self, now: Robot, name: str, consequence: str = "") -> str | None:
        """Describe in a line how a robot differs from the copy; ``None`` if it does not."""
        parts = part_hashes(now.model)
        wrong = _differing(self.content["parts"], parts)
        for what, of in _BESIDES.items() if self.whole else ():
            # Geoms that only show the robot have no place in the copy, so that indices may differ.
            if not np.array_equal(np.asarray(of(self.robot)), np.asarray(of(now))):
                wrong.append(what)
        if not wrong:
            return None
        hashes = f"hash {self.hash[:_SHORT]} in the run, {combined(parts)[:_SHORT]} there"
        return f"{name} differs from the robot of the run in {', '.join(wrong)} ({hashes}){consequence}."

    def drawn(self, robot: Robot, settings: RobotSettings) -> Robot:
        """Return the robot of the copy with its visual meshes, if its source is there and unchanged; else as it is."""
        was, source = self.source, self.find_source()
        if not self.content["left_out"] or was is None or source is None or source.sha256 != was.sha256:
            return robot
        try:
            shown = load_robot(_from(settings, source)).model
        except RobotError:
            return robot
        return replace(robot, model=shown) if physics_hash(shown) == self.hash else robot


def _there(place: str) -> Source | None:
    try:
        return find_place(place)
    except RobotError:
        return None


def _from(settings: RobotSettings, source: Source) -> RobotSettings:
    return replace(settings, name=str(source.file), source=None)


def _differing(kept: Mapping[str, str], parts: Mapping[str, str]) -> list[str]:
    return [name for name in parts if parts[name] != kept.get(name)]


_BESIDES: dict[str, Callable[[Robot], Any]] = {
    "feet": lambda robot: robot.feet,
    "forward axis": lambda robot: robot.forward_axis,
    "standing pose": lambda robot: np.round(robot.standing_qpos, 9),
    "start pose": lambda robot: np.round(robot.start_qpos, 9),
    "meaning of actions": lambda robot: np.round(robot.action_map, 9),
    "contact sensors": lambda robot: robot.contact_sensors(robot.feet),
}


def _show(model: mujoco.MjModel) -> None:
    """Let the colliding geoms of a body be drawn where its visual meshes were left out."""
    seen = (model.geom_group < _SHOWN) & (model.geom_rgba[:, 3] > 0)
    for geom in solid_geoms(model):
        body = int(model.geom_bodyid[geom])
        if body and not seen[model.geom_bodyid == body].any():
            model.geom_group[geom] = 0
            model.geom_rgba[geom, 3] = max(float(model.geom_rgba[geom, 3]), 1.0)
