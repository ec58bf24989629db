"""A robot's file while it is being completed: its content, its model, and a note for each change."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TypeVar

import mujoco
import numpy as np

from gctd3.errors import RobotError, one_line, suggest
from gctd3.robots.mjcf import base_joints, bodies_below, body_name, joint_name, root_body

T = TypeVar("T")


class Draft:
    """Hold a file's content while it is completed.

    Args:
        spec: The file's content; it is changed in place.
        file: Path of the file, for messages.
        root: Name of the robot's root body; ``None`` where there is but one.

    Attributes:
        model: The model of the file as it was when last compiled.
        notes: One sentence for each change.
        edited: Whether something was changed.
        sensed: Names of the bodies that were given a sensor of ground contact.
        short: Names of the keys whose poses do not have a number for each coordinate.
        dropped: Why keys are left out that cannot be used, by name.
    """

    def __init__(self, spec: mujoco.MjSpec, file: Path, root: str | None = None) -> None:
        self.spec, self.file = spec, file
        self.notes: list[str] = []
        self.edited = False
        self._named = False
        self.sensed: tuple[str, ...] = ()
        # MuJoCo fills keys that are too short with numbers of the reference pose, silently.
        self._written = [len(key.qpos) for key in spec.keys]
        self.dropped: dict[str, str] = {}
        self.model = self.compile()
        whole = (0, int(self.model.nq))
        # Keys that <size nkey="..."/> reserves are added behind those of the file when it is compiled.
        self.short = [k.name for k, length in zip(spec.keys, self._written, strict=False) if length not in whole]
        self.root_name = body_name(self.model, root_body(self.model, file, root))

    @property
    def root(self) -> int:
        """Return the index of the robot's root body."""
        return root_body(self.model, self.file, self.root_name)

    def edit(self, note: str | None = None) -> None:
        """Record that the file is changed, with a note if one is given."""
        self.edited = True
        if not self._named:
            self._named = True
            # What is referred to has to have a name.
            for body in self.spec.bodies[1:]:
                body.name = body.name or f"body_{body.id}"
            for joint in self.spec.joints:
                joint.name = joint.name or f"joint_{joint.id}"
        if note is not None:
            self.notes.append(note)

    def compile(self) -> mujoco.MjModel:
        """Compile the file as it is now, without keys that do not fit its joints.

        Raises:
            RobotError: If MuJoCo cannot compile it.
        """
        try:
            self.model = self.spec.compile()
            bytes(self.model.names).decode()
        except UnicodeDecodeError as error:
            raise RobotError(f"{self.file} has a name that is not UTF-8: {error}") from error
        except ValueError as error:
            if self._drop_missized(str(error)):
                return self.compile()
            raise RobotError(f"{self.file} is not an MJCF that MuJoCo can compile: {one_line(error)}") from error
        model = self.model
        numbers = (model.key_qpos, model.key_qvel, model.key_act, model.key_ctrl)
        wild = np.flatnonzero(~np.all([np.isfinite(values).all(axis=1) for values in numbers], axis=0))
        if len(wild):
            self._drop_key(int(wild[0]), "it has numbers that are not finite")
            return self.compile()
        return self.model

    def _drop_missized(self, message: str) -> bool:
        """Drop the key of a wrong size that an error is about; tell whether there is one."""
        about = re.search(r"keyframe .*: invalid \w+ size.* id (\d+)", message, re.DOTALL)
        if about is None or int(about[1]) >= len(self.spec.keys):
            return False
        self._drop_key(int(about[1]), "its size does not fit the joints and actuators")
        return True

    def _drop_key(self, index: int, why: str) -> None:
        key = self.spec.keys[index]
        name = key.name or str(index)
        self.spec.delete(key)
        del self._written[index : index + 1]
        self.dropped[name] = why
        self.edited = True
        self.notes.append(f"Key {name!r} is left out: {why}.")

    # Parts by name, in the file as it is now.

    def joints(self) -> list[int]:
        """Return the indices of the robot's joints outside its base."""
        robot, base = set(bodies_below(self.model, self.root)), set(base_joints(self.model, self.root))
        return [j for j in range(self.model.njnt) if int(self.model.jnt_bodyid[j]) in robot and j not in base]

    def body_id(self, name: str) -> int:
        """Return the index of a body of the robot by the name that :func:`.body_name` gives it."""
        return next(b for b in bodies_below(self.model, self.root) if body_name(self.model, b) == name)

    def spec_joint(self, joint: int) -> mujoco.MjsJoint:
        """Return the file's element of a joint of :attr:`model`."""
        return next(part for part in self.spec.joints if part.id == joint)

    def spec_body(self, body: int) -> mujoco.MjsBody:
        """Return the file's element of a body of :attr:`model`."""
        return next(part for part in self.spec.bodies if part.id == body)

    # Poses by the names of joints, which outlast changes of the file.

    def pose_of(self, qpos: np.ndarray) -> dict[str, np.ndarray]:
        """Return a pose of :attr:`model` by the names of its joints."""
        return {joint_name(self.model, j): qpos[_span(self.model, j)].copy() for j in range(self.model.njnt)}

    def qpos_of(self, pose: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the ``qpos`` of a pose, shape ``[nq]``; joints that it lacks are as in the reference pose."""
        qpos = self.model.qpos0.copy()
        for joint in range(self.model.njnt):
            values = pose.get(joint_name(self.model, joint))
            if values is not None:
                qpos[_span(self.model, joint)] = values
        return qpos


def _span(model: mujoco.MjModel, joint: int) -> slice:
    start = int(model.jnt_qposadr[joint])
    return slice(start, start + {0: 7, 1: 4}.get(int(model.jnt_type[joint]), 1))


def first_fitting(patterns: Mapping[str, T], name: str) -> T | None:
    """Return the value of the first pattern (``*`` and ``?``) that fits a name, ``None`` if none does."""
    return next((value for pattern, value in patterns.items() if fnmatchcase(name, pattern)), None)


def check_patterns(
    patterns: Collection[str], names: Sequence[str], what: str, file: Path, several: bool = False
) -> None:
    """Check that each pattern fits a name.

    Args:
        patterns: The patterns.
        names: The names of the file's joints.
        what: The setting, for messages.
        file: Path of the file, for messages.
        several: Whether the patterns are for several files that name joints differently, so that one has to fit.

    Raises:
        RobotError: If one does not; the message suggests a similar name.
    """
    unfit = [pattern for pattern in patterns if not any(fnmatchcase(name, pattern) for name in names)]
    if not several or len(unfit) == len(patterns):
        for pattern in unfit:
            raise RobotError(
                f"{file}: {what} names {pattern!r}, which fits no joint.{suggest(pattern, names)} "
                f"The joints are {', '.join(names)}."
            )


def listed(names: Sequence[str], most: int = 6) -> str:
    """Return names for a sentence, the first few of many."""
    if len(names) <= most:
        return ", ".join(names)
    return f"{', '.join(names[: most - 1])} and {len(names) - most + 1} more"


def spread(values: Sequence[float]) -> str:
    """Return numbers for a sentence: the one that they all are, or the smallest and the largest."""
    low, high = f"{min(values):.3g}", f"{max(values):.3g}"
    return low if low == high else f"{low} to {high}"
