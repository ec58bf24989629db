"""Mirror images of joints: reflection in the sagittal plane, read from geometry, else from names.

The sagittal plane holds the vertical and the forward axis. A hinge's axis is a pseudo-vector: its component across the
plane survives the reflection, the other two turn round. A slide's axis is a vector: only the one across turns round.
A hinge may be anchored anywhere along its axis, and two hips may share one axis: so hinges are compared as lines, and
told apart by their anchors or by what hangs on them.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from gctd3.robots.mjcf import Joint

_SIDES = (("right", "left"), ("Right", "Left"), ("R", "L"), ("r", "l"))
_NEAR = 0.02  # of the robot's extent: how far a reflected joint may lie from its partner
_EQUAL = 0.002  # of the robot's extent: among partners as near as that, names decide
_ROUNDED = 1e-6  # m
_EXACTLY = 0.1  # of the distance of the root's plane: how far pairs may be from lying about another plane
_PLANES = 5  # planes to try beside the root's


def swap_side(name: str, known: Collection[str]) -> str:
    """Return ``name`` with its side exchanged, dropped or added, if that is one of ``known``; else ``name``.

    ``hip_right`` and ``hip_left`` are a pair, and so are ``thigh`` and ``thigh_left``, ``rfemur`` and ``lfemur``,
    ``FR_foot`` and ``FL_foot``.
    """
    for right, left in _SIDES:
        for side, other in ((right, left), (left, right)):
            swapped = re.sub(rf"(?<![a-zA-Z]){side}(?![a-zA-Z])", other, name)
            if swapped != name and swapped in known:
                return swapped
    # Front or rear, and a side.
    corner = re.sub(
        r"(?<![a-zA-Z])([FRHBfrhb])([RLrl])(?![a-zA-Z])",
        lambda match: match[1] + {"r": "l", "l": "r", "R": "L", "L": "R"}[match[2]],
        name,
    )
    if corner != name and corner in known:
        return corner
    glued = {"r": "l", "l": "r", "R": "L", "L": "R"}.get(name[:1], name[:1]) + name[1:]
    if glued != name and glued in known:
        return glued
    plain = without_side(name)
    if plain != name:
        return plain if plain in known else name
    sided = [other for other in known if other != name and without_side(other) == name]
    return sided[0] if len(sided) == 1 else name


def without_side(name: str) -> str:
    """Return ``name`` without the word ``right`` or ``left``."""
    return re.sub(r"(?i)_(right|left)(?![a-z])|(?<![a-z])(right|left)_", "", name)


@dataclass(frozen=True)
class Plane:
    """Represent a sagittal plane: the points ``p`` with ``p @ lateral == offset``.

    Attributes:
        lateral: Unit vector across the plane, shape ``[3]``.
        offset: Where the plane is along it (m).
    """

    lateral: np.ndarray
    offset: float

    @property
    def matrix(self) -> np.ndarray:
        """Return the reflection of vectors, shape ``[3, 3]``."""
        return np.asarray(np.eye(3) - 2.0 * np.outer(self.lateral, self.lateral))

    def place(self, places: np.ndarray) -> np.ndarray:
        """Reflect places ``[*, 3]`` (m)."""
        return np.asarray(places @ self.matrix + 2.0 * self.offset * self.lateral)


@dataclass(frozen=True)
class Pairs:
    """Hold the mirror images of joints.

    Attributes:
        plane: The sagittal plane.
        images: The mirror image of each joint, by name, often its own: an involution that keeps the kinematic tree.
        placed: Names of the joints that lie where their images' reflections do.
    """

    plane: Plane
    images: dict[str, str]
    placed: frozenset[str]


def pair_joints(
    model: mujoco.MjModel,
    root: int,
    joints: Sequence[Joint],
    pose: np.ndarray,
    lateral: np.ndarray,
    last: Collection[str] = (),
) -> Pairs:
    """Pair each joint with its mirror image, else with itself: an involution that maps the kinematic tree onto itself.

    A pair lies mirrored in the given pose, which is a symmetric one if the robot stands. Names decide among joints that
    lie in the same place (the two legs of a planar robot do), and where no joint is in the reflected place.

    Args:
        model: The model.
        root: Index of the root body. The sagittal plane passes through it, unless more joints have images in another
            plane.
        joints: The joints to pair; their parents are among them.
        pose: The ``qpos`` in which they are compared, shape ``[nq]``.
        lateral: Unit vector across the sagittal plane, shape ``[3]``.
        last: Names of the joints that a foot hangs on.
    """
    return _Matching(model, root, joints, pose, lateral, last).pairs()


def reflected_signs(
    model: mujoco.MjModel,
    pose: np.ndarray,
    joints: Sequence[Joint],
    images: Mapping[str, str],
    lateral: np.ndarray,
) -> dict[str, float]:
    """Return for each joint +1 if equal angles of it and its mirror image mirror each other, -1 if opposite ones do.

    Args:
        model: The model.
        pose: The :func:`zero_pose`.
        joints: The joints.
        images: The mirror image of each joint, by name.
        lateral: Unit vector across the sagittal plane, shape ``[3]``.
    """
    axes = _pose_of(model, pose).xaxis
    reflected = reflect_axes(axes[[joint.id for joint in joints]], joints, lateral)
    ids = {joint.name: joint.id for joint in joints}
    along = [float(axis @ axes[ids[images[joint.name]]]) for axis, joint in zip(reflected, joints, strict=True)]
    return {joint.name: 1.0 if same > 0.0 else -1.0 for joint, same in zip(joints, along, strict=True)}


def reflect_axes(axes: np.ndarray, joints: Sequence[Joint], lateral: np.ndarray) -> np.ndarray:
    """Reflect the axes of joints, shape ``[J, 3]``."""
    flip = np.array([1.0 if joint.kind == "slide" else -1.0 for joint in joints])
    return np.asarray(flip[:, None] * (axes.reshape(-1, 3) @ Plane(lateral, 0.0).matrix))


def zero_pose(model: mujoco.MjModel, joints: Sequence[Joint], pose: np.ndarray) -> np.ndarray:
    """Return a pose in which joints other than balls are at zero, which must be symmetric. Shape ``[nq]``.

    Mirrored angles are equal or opposite ones, so that it is angles of zero that must be symmetric.
    """
    zero = pose.copy()
    for joint in joints:
        if joint.kind == "ball":
            zero[joint.qpos : joint.qpos + 4] = model.qpos0[joint.qpos : joint.qpos + 4]
        else:
            zero[joint.qpos] = 0.0
    return zero


def line_distance(gaps: np.ndarray, axes: np.ndarray, kinds: Sequence[str]) -> np.ndarray:
    """Measure how far joints are from one another, given the gaps between their anchors ``[J, 3]`` (m), shape ``[J]``.

    A hinge is a line, a ball a point; a slide moves its body alike wherever it is.
    """
    along = np.sum(gaps * axes, axis=-1, keepdims=True) * axes
    across = np.linalg.norm(gaps - along, axis=-1)
    full = np.linalg.norm(gaps, axis=-1)
    return np.array([{"hinge": a, "slide": 0.0}.get(k, f) for k, a, f in zip(kinds, across, full, strict=True)])


def _pose_of(model: mujoco.MjModel, qpos: np.ndarray) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    return data


class _Matching:
    """Find the mirror images of joints, from the root down, so that the tree is kept."""

    def __init__(
        self,
        model: mujoco.MjModel,
        root: int,
        joints: Sequence[Joint],
        pose: np.ndarray,
        lateral: np.ndarray,
        last: Collection[str],
    ) -> None:
        data = _pose_of(model, pose)
        mujoco.mj_comPos(model, data)
        ids = [joint.id for joint in joints]
        bodies = model.jnt_bodyid[ids]
        self.joints, self.lateral = joints, lateral
        self.anchors, self.axes = data.xanchor[ids], data.xaxis[ids]
        # What hangs on a joint is where it is, however its anchor and its body's frame were chosen.
        self.weights = data.subtree_com[bodies]
        self.balls = np.array([joint.kind == "ball" for joint in joints])
        every = np.concatenate([self.anchors, self.weights])
        extent = max(float(np.ptp(every, axis=0).max()), 1e-6)
        self.near, self.equal = _NEAR * extent, _EQUAL * extent
        self.below: dict[str | None, list[int]] = {}
        for k, joint in enumerate(joints):
            self.below.setdefault(joint.parent, []).append(k)
        self.names = [joint.name for joint in joints]
        slots = [(joint.kind, joint.id - int(model.body_jntadr[b])) for joint, b in zip(joints, bodies, strict=True)]
        shapes = [
            (*slot, int(model.body_jntnum[b]), name in last)
            for slot, b, name in zip(slots, bodies, self.names, strict=True)
        ]
        self.alike = np.array([[one == other for other in shapes] for one in shapes])
        self.plane, self.cost = self._find_plane(float(data.xpos[root] @ lateral))
        self.placed: set[str] = set()

    # Places.

    def _costs(self, offset: float) -> np.ndarray:
        """Measure how far each joint's reflection is from each other joint (m); infinite if it cannot be its image."""
        plane, n = Plane(self.lateral, offset), len(self.joints)
        axes = reflect_axes(self.axes, self.joints, self.lateral)
        parallel = (np.abs(axes @ self.axes.T) > 0.99) | self.balls[:, None]
        gaps = plane.place(self.anchors)[:, None] - self.anchors[None]
        kinds = [joint.kind for joint in self.joints]
        lines = np.stack(
            [line_distance(gaps[:, k], np.tile(self.axes[k], (n, 1)), [kinds[k]] * n) for k in range(n)], 1
        )
        weights = np.linalg.norm(plane.place(self.weights)[:, None] - self.weights[None], axis=-1)
        cost = np.minimum(np.linalg.norm(gaps, axis=-1), weights)
        cost = np.where(self.alike & parallel & (lines <= self.near) & (cost <= self.near), cost, np.inf)
        return np.asarray(np.maximum(cost, cost.T))

    def _find_plane(self, root: float) -> tuple[Plane, np.ndarray]:
        """Find the plane through the root's place along the lateral axis, or one in which more joints have images.

        Or the one midway between the joints that are pairs, if they lie exactly about that, and the root is beside it.
        """
        cost = self._costs(root)
        best, most = root, int(np.isfinite(cost).any(axis=1).sum())
        if most < len(self.joints):
            for offset in self._midway():
                other = self._costs(offset)
                count = int(np.isfinite(other).any(axis=1).sum())
                if count > most:
                    best, most, cost = offset, count, other
        middles = self._middles(cost)
        if len(middles) > 1:  # one pair could itself be the asymmetry
            middle = float(np.median(middles))
            spread, median_spread = (float(np.abs(middles - offset).mean()) for offset in (best, middle))
            if spread > _ROUNDED and median_spread < _EXACTLY * spread:
                best, cost = middle, self._costs(middle)
        return Plane(self.lateral, best), cost

    def _middles(self, cost: np.ndarray) -> np.ndarray:
        """Return the places along the lateral axis midway between pairs, whose anchors say where they are along it."""
        located = self.balls | (np.abs(self.axes @ self.lateral) < 0.99)
        along, nearest = self.anchors @ self.lateral, cost.argmin(axis=1)
        pairs = [
            (i, k)
            for i, k in enumerate(nearest.tolist())
            if i < k and located[i] and np.isfinite(cost[i, k]) and nearest[k] == i
        ]
        return np.array([(along[i] + along[k]) / 2 for i, k in pairs])

    def _midway(self) -> list[float]:
        """Return the places along the lateral axis midway between the most joints that could be a pair."""
        middles: list[float] = []
        for places in (self.anchors, self.weights):
            gaps = places[:, None] - places[None]
            gaps = gaps - (gaps @ self.lateral)[..., None] * self.lateral
            level = np.triu(self.alike & (np.linalg.norm(gaps, axis=-1) <= self.near), k=1)
            along = places @ self.lateral
            middles.extend((0.5 * (along[:, None] + along[None]))[level].tolist())
        planes: list[float] = []
        left = np.array(middles)
        while len(left) and len(planes) < _PLANES:
            votes = (np.abs(left[:, None] - left[None]) <= self.equal).sum(axis=1)
            middle = float(np.median(left[np.abs(left - left[votes.argmax()]) <= self.equal]))
            planes.append(middle)
            left = left[np.abs(left - middle) > self.near]
        return planes

    # The tree.

    def pairs(self) -> Pairs:
        """Return the pairs."""
        matches = self._within(None)
        images = {self.names[i]: self.names[k] for i, k in matches.items()}
        placed = frozenset(self.names[i] for i, k in matches.items() if np.isfinite(self.cost[i, k]))
        return Pairs(self.plane, images, placed)

    def _within(self, parent: str | None) -> dict[int, int]:
        """Pair the joints below one that is its own image, among one another or with themselves."""
        own = self.below.get(parent, [])
        images: dict[int, int] = {}
        for i, k in self._ranked(own, own):
            if i in images or k in images:
                continue
            if i == k:
                images |= {i: i, **self._within(self.names[i])}
            elif (inner := self._between(i, k)) is not None:
                images |= inner
        for i in own:
            if i not in images:
                images |= {i: i, **self._within(self.names[i])}
        return images

    def _between(self, i: int, k: int) -> dict[int, int] | None:
        """Pair two joints and all below them, both ways; ``None`` if a joint below has no image."""
        images = {i: k, k: i}
        children, others = self.below.get(self.names[i], []), self.below.get(self.names[k], [])
        if len(children) != len(others):
            return None
        for a, b in self._ranked(children, others):
            if a not in images and b not in images and (inner := self._between(a, b)) is not None:
                images |= inner
        return images if all(a in images for a in children) else None

    def _ranked(self, joints: Sequence[int], partners: Sequence[int]) -> list[tuple[int, int]]:
        """Return the pairs to try, the best first: by place, names deciding among equals; then by name alone."""
        known = {self.names[k] for k in (*joints, *partners)}
        ranked = []
        for i in joints:
            other = swap_side(self.names[i], known)
            for k in partners:
                if joints is partners and k < i:
                    continue
                named = k != i and self.names[k] == other
                if np.isfinite(self.cost[i, k]):
                    ranked.append((0, self.cost[i, k] - (self.equal if named else 0.0), i, k))
                elif named and self.alike[i, k]:
                    ranked.append((1, 0.0, i, k))
        return [(i, k) for *_, i, k in sorted(ranked)]
