"""How a robot's root body moves about the world: on a boom, in a plane, or freely, whatever joints it has for that.

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
    """A coordinate of the base that one slide or hinge holds.

    Attributes:
        qpos: Index in ``qpos``.
        qvel: Index in ``qvel``.
        sign: Of both.
    """

    qpos: int
    qvel: int
    sign: float


@dataclass(frozen=True)
class Base:
    """The root body's freedom to move.

    Attributes:
        model: The model.
        root: Index of the root body.
        axis: Where forward is, of the world's axes.
    """

    model: mujoco.MjModel
    root: int
    axis: Axis

    @property
    def frame(self) -> np.ndarray:
        """Rows forward, side and up, in the world's axes. Shape ``[3, 3]``."""
        forward = AXES[self.axis]
        return np.stack([forward, np.cross(UP, forward), UP])

    @cached_property
    def free(self) -> Coordinate | None:
        """Where the free joint's first numbers are, if the base has one."""
        for joint in base_joints(self.model, self.root):
            if joint_kind(self.model, joint) == "free":
                return Coordinate(int(self.model.jnt_qposadr[joint]), int(self.model.jnt_dofadr[joint]), 1.0)
        return None

    @property
    def height(self) -> Coordinate | None:
        """Where the coordinate along z is, if the base has one."""
        if self.free is not None:
            return Coordinate(self.free.qpos + 2, self.free.qvel + 2, 1.0)
        return self.single.get("height")

    @cached_property
    def single(self) -> dict[str, Coordinate]:
        """Coordinates of slides and hinges along an axis of :attr:`frame`, by name."""
        found = {}
        for joint in base_joints(self.model, self.root):
            kind = joint_kind(self.model, joint)
            if kind not in ("slide", "hinge"):
                continue
            along = self.frame @ self._reference_axis(joint)
            for name, component in zip(SLIDES if kind == "slide" else TURNS, along, strict=True):
                if abs(component) > 0.999 and name not in found:
                    place = int(self.model.jnt_qposadr[joint]), int(self.model.jnt_dofadr[joint])
                    found[name] = Coordinate(*place, float(np.sign(component)))
        return found

    def _reference_axis(self, joint: int) -> np.ndarray:
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, self.model.body_quat[self.root])
        return np.asarray(turn.reshape(3, 3) @ self.model.jnt_axis[joint])

    @property
    def kind(self) -> str:
        """``fixed``, ``boom`` (forward and up), ``planar`` (and pitch), ``free``, or ``other``."""
        if self.free is not None:
            return "free"
        known = {frozenset(): "fixed", frozenset(("forward", "height")): "boom"}
        known[frozenset(("forward", "height", "pitch"))] = "planar"
        return "other" if self.unread else known.get(frozenset(self.single), "other")

    @property
    def unread(self) -> tuple[int, ...]:
        """Indices of the joints that no coordinate holds: balls, axes that are none of :attr:`frame`, repeated ones."""
        if self.free is not None:
            return ()
        held = {coordinate.qpos for coordinate in self.single.values()}
        return tuple(j for j in base_joints(self.model, self.root) if int(self.model.jnt_qposadr[j]) not in held)

    def check_read(self, file: Path) -> None:
        """Check that the coordinates say all of how the root body moves.

        Args:
            file: What to call the MJCF.

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
        """Names of what can change."""
        return (*SLIDES, *TURNS) if self.free is not None else tuple(self.single)

    @property
    def extra(self) -> tuple[str, ...]:
        """Those of them that get a node of their own, since the root's holds height and forward velocity only."""
        return tuple(name for name in EXTRA if name in self.coordinates)

    def read(self, qpos: np.ndarray, qvel: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Every coordinate (m or rad, from the world's origin) and its rate (m/s or rad/s), each of shape ``[*]``.

        A free base's angles are from the standing pose, and its angular rates those that a gyroscope on it measures.

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


def find_forward(model: mujoco.MjModel, root: int, joints: list[Joint], reflected: dict[str, int]) -> Axis:
    """Forward, where nobody says: along the base's only horizontal slide; else the axis about which sides are equal.

    Args:
        model: The model.
        root: Index of the root body.
        joints: The robot's joints; of no use to a base on slides.
        reflected: For forward ``x`` and ``y``, how many joints have a mirror image; ``x`` if they are equal.
    """
    slides = [axis for axis in ("x", "y") if "forward" in Base(model, root, axis).single]
    if len(slides) == 1:
        return "x" if slides[0] == "x" else "y"
    return "y" if joints and reflected["y"] > reflected["x"] else "x"


def _signed(values: np.ndarray, sign: float) -> np.ndarray:
    return np.array(values) if sign > 0 else -values


def _matrix(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrices of unit quaternions ``[*, 4]`` (w first), shape ``[*, 3, 3]``."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
