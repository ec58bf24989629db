"""The copy of its robot that a run keeps: the model that was completed for it, whatever becomes of its source.

* ``robot/manifest.json``: what the robot is: feet, forward axis, actions, hash, source, checksums of the other files.
* ``robot/robot.xml``: the completed model, as MuJoCo reads it; beside it colliding meshes and heightfields.
* ``robot/numbers.npz``: its numbers to the last bit, for MuJoCo writes an MJCF with six digits.
"""

from __future__ import annotations

import functools
import sys
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import gctd3
from gctd3.errors import RobotError, RunError
from gctd3.files import (
    OWN_MJCF,
    OWN_ROBOT,
    check_file,
    read_manifest,
)
from gctd3.robots.blueprint import Blueprint
from gctd3.robots.keep import FORMAT, NUMBERS, has_robot, numbers
from gctd3.robots.load import load_robot
from gctd3.robots.physics import combined, part_hashes, physics_hash, solid_geoms
from gctd3.robots.robot import Robot
from gctd3.robots.settings import RobotSettings
from gctd3.robots.sources import DESCRIPTION, MENAGERIE, Source, find_place, package_of

_MARGIN = 1e-5  # m: by how much the boxes are wider in which MuJoCo looks for contacts; it only has to find them
_SHOWN = 3  # groups of geoms from this one on are not drawn
_SHORT = 12  # digits of a hash in a message


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
            text = read.pop(OWN_MJCF).decode()
            model = mujoco.MjSpec.from_string(text, assets=read).compile()
            self._put_numbers(model)
        except (RobotError, ValueError, OSError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise RunError(f"{self.folder} cannot be read: {error}") from error
        self._check(model)
        if self.content["left_out"]:
            _show(model)
        try:
            about = self.content["robot"]
            facts = {"root_name": about["root"], "notes": tuple(about["notes"]), "held": about["held"]}
            places = Path(about["path"]), about["feet"], about["forward_axis"]
            scale, command = (
                None if about[k] is None else tuple(about[k]) for k in ("action_scale", "standing_command")
            )
        except (KeyError, TypeError) as error:
            raise RunError(f"{self.folder} cannot be read: it lacks or misstates {error} of its robot.") from error
        robot = Robot.from_model(model, *places, driven=True, source=self.source, **facts)
        blueprint = Blueprint(functools.partial(mujoco.MjSpec.from_string, text, assets=read))
        return replace(robot, action_scale=scale, standing_command=command, blueprint=blueprint)

    def _put_numbers(self, model: mujoco.MjModel) -> None:
        with np.load(self.folder / NUMBERS, allow_pickle=False) as kept:
            for name, values in numbers(model):
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
            shown = load_robot(_from(settings, source))
        except RobotError:
            return robot
        if physics_hash(shown.model) != self.hash:
            return robot
        return replace(robot, model=shown.model, blueprint=shown.blueprint)


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
