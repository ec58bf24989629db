"""Reflection of a robot's observations and actions in its sagittal (xz) plane, as signed permutations.

Pure NumPy. If the left and right sides of a robot are equal, the reflection of its state and its actions gives the
reflection of its motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gctd3.errors import RobotError
from gctd3.robots.graph import KinematicGraph
from gctd3.robots.model_reflection import misplaced_joints
from gctd3.robots.robot import Robot
from gctd3.tasks.feature_table import FeatureTable
from gctd3.tasks.features import paper_features


@dataclass(frozen=True, eq=False)
class SignedPermutation:
    """Represent ``reflected[..., i] = sign[i] * values[..., source[i]]``, which is its own inverse.

    Attributes:
        source: Index of the source of each value, shape ``[D]``, integers.
        sign: Sign of each value, shape ``[D]``, +1 or -1.
    """

    source: np.ndarray
    sign: np.ndarray

    def __post_init__(self) -> None:
        identity = np.arange(len(self.source))
        if not (np.array_equal(self.source[self.source], identity) and (self.sign * self.sign[self.source] == 1).all()):
            raise RobotError(
                "A reflection done twice must change nothing, got source "
                f"{self.source.tolist()} and sign {self.sign.tolist()}."
            )

    @property
    def matrix(self) -> np.ndarray:
        """Return the matrix ``M`` of shape ``[D, D]`` for which ``values @ M`` are the reflected values."""
        matrix = np.zeros((len(self.source), len(self.source)))
        matrix[self.source, np.arange(len(self.source))] = self.sign
        return matrix


@dataclass(frozen=True, eq=False)
class Reflection:
    """Represent the reflection of a robot's observations and actions.

    Attributes:
        features: Number of features of a node in one frame.
        frame: Reflection of the nodes' features in one frame, node after node; length ``N * features``.
        action: Reflection of the action; length ``A``.
        counters: Reflection of the critics' privileged input.
        static: Number of constant features of a node, after those of all frames.
    """

    features: int
    frame: SignedPermutation
    action: SignedPermutation
    counters: SignedPermutation
    static: int = 0

    @classmethod
    def of(
        cls,
        robot: Robot,
        table: FeatureTable,
        counters: Sequence[tuple[np.ndarray, np.ndarray]] = (),
        static: int = 0,
    ) -> Reflection:
        """Return the reflection of a robot whose nodes have the features of a table.

        Joints exchange places with their mirror images, and their angles and velocities change signs as their axes
        require; contacts of feet exchange places too.

        Args:
            robot: The robot.
            table: Features of its nodes.
            counters: Source and sign of each part of the critics' privileged input, see
                :meth:`.Termination.clock_mirror`.
            static: Number of constant features of a node, after those of all frames, see :meth:`.NodeSensor.static`.

        Raises:
            RobotError: If the robot has a ball joint, or its base can leave the sagittal plane and its joints are not
                symmetric to that plane. Whether the two sides also move alike is for :func:`.check_mirror` to say.
        """
        if odd := misplaced_joints(robot):
            raise RobotError(
                f"{robot.path} is not the same on its left and its right, so that no motion of it has a mirror image. "
                "Set replay.mirror=false, and network.equivariant=false if that is on; or mend these joints, whose "
                f"reflection is neither themselves nor the joint of the other side: {', '.join(odd)}."
            )
        graph = table.graph
        if balls := [name for name, kind in zip(graph.nodes, graph.kinds, strict=True) if kind == "ball"]:
            raise RobotError(
                f"{robot.path}: a ball joint's rotation has no reflection here, so replay.mirror and equivariant must "
                f"be false; ball joints: {', '.join(balls)}."
            )
        sources, signs, start = [np.zeros(0, dtype=np.int64)], [np.zeros(0)], 0
        for source, sign in counters:
            sources.append(start + np.asarray(source))
            signs.append(np.asarray(sign, dtype=np.float64))
            start += len(source)
        return cls(
            features=table.width,
            frame=SignedPermutation(*table.reflection()),
            action=SignedPermutation(*robot.action_mirror),
            counters=SignedPermutation(np.concatenate(sources), np.concatenate(signs)),
            static=static,
        )

    @classmethod
    def from_robot(cls, robot: Robot, static: int = 0) -> Reflection:
        """Return the reflection of a robot whose nodes have the paper's features; see :meth:`of`."""
        return cls.of(robot, FeatureTable(paper_features(), robot, KinematicGraph.from_robot(robot)), static=static)

    def nodes(self, width: int) -> SignedPermutation:
        """Return the reflection of stacked frames, node after node: frames from oldest to newest, then static features.

        Static features identify the joint of a node. The reflection leaves them unchanged, since the joint stays the
        same.

        Args:
            width: Number of features of a node over all frames, static ones included.

        Raises:
            ValueError: If ``width`` is not a whole number of frames and the static features.
        """
        history, rest = divmod(width - self.static, self.features)
        if rest or history < 1:
            behind = f" and {self.static} that never change" if self.static else ""
            raise ValueError(
                f"Nodes of {self.features} features a frame{behind} cannot be {width} features wide; "
                "features that never change are for Reflection.from_robot(robot, static=...) to name."
            )
        shape = (-1, 1, self.features)
        node, feature = np.divmod(self.frame.source.reshape(shape), self.features)
        source = node * width + np.arange(history)[:, None] * self.features + feature
        sign = np.broadcast_to(self.frame.sign.reshape(shape), source.shape)
        count = len(source)
        still = np.arange(count * width).reshape(count, width)[:, history * self.features :]
        return SignedPermutation(
            np.concatenate([source.reshape(count, -1), still], axis=1).reshape(-1),
            np.concatenate([sign.reshape(count, -1), np.ones(still.shape)], axis=1).reshape(-1),
        )
