"""The degrees of freedom of a robot's root body: on a boom, in a plane, or free, made of any joints.

Frame: forward as the caller says, up, and side to the left of both. Angles: roll about forward, pitch about side (nose
down is positive), yaw about up (to the left is positive).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np

from gctd3.errors import RobotError
from gctd3.robots.mirror_pairs import pair_joints, swap_side
from gctd3.robots.mjcf import Joint, base_joints, body_name, joint_kind, joint_name, standing_pose

Axis = Literal["x", "-x", "y", "-y"]
AXES: dict[str, np.ndarray] = {
    "x": np.array([1.0, 0.0, 0.0]),
    "-x": np.array([-1.0, 0.0, 0.0]),
    "y": np.array([0.0, 1.0, 0.0]),
    "-y": np.array([0.0, -1.0, 0.0]),
}
UP = np.array([0.0, 0.0, 1.0])
SLIDES = ("forward", "side", "height")
TURNS = ("roll", "pitch", "yaw")
# Coordinates that the root node does not hold, and whether they keep their sign in the mirror.
EXTRA = {"pitch": 1.0, "roll": -1.0, "yaw": -1.0, "side": -1.0}


@dataclass(frozen=True)
class Coordinate:
    """Locate a coordinate of the base in ``qpos`` and ``qvel``.

    Attributes:
        qpos: Index in ``qpos``.
        qvel: Index in ``qvel``.
        sign: Sign of both along the axis of :attr:`Base.frame`.
    """

    qpos: int
    qvel: int
    sign: float


@dataclass(frozen=True)
class Base:
    """Represent the base: the degrees of freedom of the root body.

    Attributes:
        model: The model.
        root: Index of the root body.
        axis: Forward direction among the world's axes.
    """

    model: mujoco.MjModel
    root: int
    axis: Axis

    @property
    def frame(self) -> np.ndarray:
        """Return the rows forward, side and up of the base's frame, in the world's axes. Shape ``[3, 3]``."""
        forward = AXES[self.axis]
        return np.stack([forward, np.cross(UP, forward), UP])

    @cached_property
    def free(self) -> Coordinate | None:
        """Locate the first position and velocity of the free joint; ``None`` if the base has none."""
        for joint in base_joints(self.model, self.root):
            if joint_kind(self.model, joint) == "free":
                return Coordinate(int(self.model.jnt_qposadr[joint]), int(self.model.jnt_dofadr[joint]), 1.0)
        return None

    @property
    def height(self) -> Coordinate | None:
        """Locate the coordinate along z; ``None`` if the base has none."""
        if self.free is not None:
            return Coordinate(self.free.qpos + 2, self.free.qvel + 2, 1.0)
        return self.single.get("height")

    @cached_property
    def single(self) -> dict[str, Coordinate]:
        """Return the coordinates of slides and hinges along an axis of :attr:`frame`, by name."""
        coordinates = {}
        for joint in base_joints(self.model, self.root):
            kind = joint_kind(self.model, joint)
            if kind not in ("slide", "hinge"):
                continue
            along = self.frame @ self._reference_axis(joint)
            for name, component in zip(SLIDES if kind == "slide" else TURNS, along, strict=True):
                if abs(component) > 0.999 and name not in coordinates:
                    place = int(self.model.jnt_qposadr[joint]), int(self.model.jnt_dofadr[joint])
                    coordinates[name] = Coordinate(*place, float(np.sign(component)))
        return coordinates

    def _reference_axis(self, joint: int) -> np.ndarray:
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, self.model.body_quat[self.root])
        return np.asarray(turn.reshape(3, 3) @ self.model.jnt_axis[joint])

    @property
    def kind(self) -> str:
        """Return the kind: ``fixed``, ``boom`` (forward and up), ``planar`` (and pitch), ``free``, or ``other``."""
        if self.free is not None:
            return "free"
        known = {frozenset(): "fixed", frozenset(("forward", "height")): "boom"}
        known[frozenset(("forward", "height", "pitch"))] = "planar"
        return "other" if self.unread else known.get(frozenset(self.single), "other")

    @property
    def unread(self) -> tuple[int, ...]:
        """Return the indices of the joints without a coordinate: balls, axes not in :attr:`frame`, repeated ones."""
        if self.free is not None:
            return ()
        held = {coordinate.qpos for coordinate in self.single.values()}
        return tuple(j for j in base_joints(self.model, self.root) if int(self.model.jnt_qposadr[j]) not in held)

    def check_read(self, file: Path) -> None:
        """Check that the coordinates describe every joint of the root body.

        Args:
            file: Path of the MJCF, for messages.

        Raises:
            RobotError: If a joint is :attr:`unread`; the message names it.
        """
        for joint in self.unread:
            kind, axis = joint_kind(self.model, joint), " ".join(f"{value:.3g}" for value in self.model.jnt_axis[joint])
            what = "a ball" if kind == "ball" else f"a {kind} along {axis}"
            raise RobotError(
                f"{file}: joint {joint_name(self.model, joint)!r} of the root body "
                f"{body_name(self.model, self.root)!r}, {what}, is not understood: "
                "a base is a free joint, or at most one slide and one hinge along each of the world's axes."
            )

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Return the names of the coordinates that can change."""
        return (*SLIDES, *TURNS) if self.free is not None else tuple(self.single)

    @property
    def extra(self) -> tuple[str, ...]:
        """Return the coordinates with a node of their own, as the root's holds height and forward velocity only."""
        return tuple(name for name in EXTRA if name in self.coordinates)

    def read(self, qpos: np.ndarray, qvel: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Read every coordinate (m or rad, from the world's origin) and its rate (m/s or rad/s), each of shape ``[*]``.

        A free base's angles are relative to the standing pose; its angular rates are those of a gyroscope on it.

        Args:
            qpos: Generalised positions, shape ``[*, nq]``.
            qvel: Generalised velocities, shape ``[*, nv]``.
        """
        if self.free is None:
            return {
                name: (_signed(qpos[..., c.qpos], c.sign), _signed(qvel[..., c.qvel], c.sign))
                for name, c in self.single.items()
            }
        q, v = self.free.qpos, self.free.qvel
        place, speed = qpos[..., q : q + 3] @ self.frame.T, qvel[..., v : v + 3] @ self.frame.T
        # From the forward frame of the standing body to that of the body now.
        still = _matrix(standing_pose(self.model)[q + 3 : q + 7])
        turn = self.frame @ _matrix(qpos[..., q + 3 : q + 7]) @ still.T @ self.frame.T
        angles = (
            np.arctan2(turn[..., 2, 1], turn[..., 2, 2]),
            np.arcsin(np.clip(-turn[..., 2, 0], -1.0, 1.0)),
            np.arctan2(turn[..., 1, 0], turn[..., 0, 0]),
        )
        rates = qvel[..., v + 3 : v + 6] @ (self.frame @ still).T
        read = {name: (place[..., i], speed[..., i]) for i, name in enumerate(SLIDES)}
        return {**read, **{name: (angles[i], rates[..., i]) for i, name in enumerate(TURNS)}}


def find_forward(model: mujoco.MjModel, root: int, joints: list[Joint]) -> Axis:
    """Find the default forward axis: the base's only horizontal slide, else the axis for which the sides are equal.

    That is ``y`` if more joints lie at the reflected place of another one for forward ``y`` than for ``x``, or as many
    and more of them with names of two sides; else ``x``. Joints in the middle say little: a waist is in both planes.

    Args:
        model: The model.
        root: Index of the root body.
        joints: The robot's joints; unused if the base has one horizontal slide.
    """
    slides = [axis for axis in ("x", "y") if "forward" in Base(model, root, axis).single]
    if len(slides) == 1:
        return "x" if slides[0] == "x" else "y"
    if not joints:
        return "x"
    pose, names = standing_pose(model), [joint.name for joint in joints]

    def sides(axis: Axis) -> tuple[int, int]:
        paired = pair_joints(model, root, joints, pose, Base(model, root, axis).frame[1])
        pairs = [name for name in paired.placed if paired.images[name] != name]
        return len(pairs), sum(swap_side(name, names) == paired.images[name] for name in pairs)

    return "y" if sides("y") > sides("x") else "x"


def _signed(values: np.ndarray, sign: float) -> np.ndarray:
    return np.array(values) if sign > 0 else -values


def _matrix(quaternion: np.ndarray) -> np.ndarray:
    """Compute the rotation matrices of unit quaternions ``[*, 4]`` (w first), shape ``[*, 3, 3]``."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
