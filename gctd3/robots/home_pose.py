"""A standing pose for a robot whose file names none.

Every foot is below its hip, the soles are level and the legs bent to 87 % of their length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from gctd3.robots.bounded_fit import fit_within
from gctd3.robots.clearance import clearance, foot_points, placed
from gctd3.robots.floating_base import UP
from gctd3.robots.geometry import lowest_point
from gctd3.robots.ground import can_collide, geoms_of
from gctd3.robots.mjcf import driven_joints
from gctd3.robots.pose_limits import clipped, lowered

BENT = 0.87  # of a leg's length


@dataclass(frozen=True)
class _Leg:
    """Hold the numbers of a leg for the search.

    Attributes:
        foot: Index of its foot.
        sole: Middle of the sole in the foot's frame (m).
        level: Rows: directions in the foot's frame that are up and forward where the sole is level; ``None`` for a
            ball. Shape ``[2, 3]``.
        joints: Its own joints, from the root down.
        hip: The one of them that swings the leg forward.
        knee: The next of the kind; ``None`` if there is none.
    """

    foot: int
    sole: np.ndarray
    level: np.ndarray | None
    joints: tuple[int, ...]
    hip: int
    knee: int | None


def find_pose(
    model: mujoco.MjModel, root: int, floor: int, feet: Sequence[int], forward: np.ndarray
) -> np.ndarray | None:
    """Find a pose in which the robot stands on its feet with bent legs, shape ``[nq]``.

    Args:
        model: The model.
        root: Index of the robot's root body.
        floor: Index of the geom that it stands on.
        feet: Indices of its feet.
        forward: Unit vector along which it walks, shape ``[3]``.

    Returns:
        ``None`` if its legs cannot be bent: they have fewer than two joints that swing them forward.
    """
    base, _ = clipped(model, model.qpos0, range(model.njnt))
    data = placed(model, base)
    lateral = np.cross(UP, forward)
    chains = [_chain(model, root, foot) for foot in feet]
    # A waist, which several legs hang on, is none of theirs: each would bend it its own way.
    own = [[j for j in chain if sum(j in other for other in chains) == 1] for chain in chains]
    legs = [_leg(model, data, foot, floor, joints, lateral) for foot, joints in zip(feet, own, strict=True)]
    chosen = [leg for leg in legs if leg is not None and leg.knee is not None]
    if len(chosen) < len(feet):
        return None
    backward = 1.0 if len(feet) > 2 else -1.0
    shift, pose = 0.0, base
    for _ in range(3):
        for leg in chosen:
            pose = _bend(model, pose, base, leg, forward, shift, backward)
        data = placed(model, pose)
        mujoco.mj_comPos(model, data)
        places = np.array([data.xpos[leg.foot] + _rotation(data, leg.foot) @ leg.sole for leg in chosen]) @ forward
        middle = float(data.subtree_com[root] @ forward)
        low, high = float(places.min()), float(places.max())
        spare = 0.25 * (high - low)
        # A robot on two legs balances above their middle; on more, well between the first and the last.
        target = float(places.mean()) if len(feet) == 2 else float(np.clip(middle, low + spare, high - spare))
        if abs(middle - target) < 1e-3:
            break
        shift += middle - target
    pose = _alike(model, pose, chosen, lateral, forward)
    return lowered(model, root, pose, min(clearance(model, placed(model, pose), foot, floor) for foot in feet))


def _alike(
    model: mujoco.MjModel, pose: np.ndarray, legs: Sequence[_Leg], lateral: np.ndarray, forward: np.ndarray
) -> np.ndarray:
    """Return a pose in which legs that stand beside each other have equal or opposite angles, to a thousandth."""
    data, even = placed(model, pose), pose.copy()
    places = [data.xpos[leg.foot] + _rotation(data, leg.foot) @ leg.sole for leg in legs]
    middle = float(np.mean(places, axis=0) @ lateral)
    for i, leg in enumerate(legs):
        for other, place in zip(legs[i + 1 :], places[i + 1 :], strict=True):
            away = float((places[i] - place) @ forward), float((places[i] + place) @ lateral) / 2 - middle
            if len(leg.joints) != len(other.joints) or np.abs(away).max() > 0.03:
                continue
            for joint, partner in zip(leg.joints, other.joints, strict=True):
                a, b = int(model.jnt_qposadr[joint]), int(model.jnt_qposadr[partner])
                sign = 1.0 if abs(pose[a] - pose[b]) <= abs(pose[a] + pose[b]) else -1.0
                even[a] = round((pose[a] + sign * pose[b]) / 2, 3)
                even[b] = sign * even[a]
    return clipped(model, even, [j for leg in legs for j in leg.joints])[0]


def _chain(model: mujoco.MjModel, root: int, foot: int) -> list[int]:
    """Return the indices of the hinges between the root and a foot, downwards, that may be driven."""
    driven, joints, body = set(driven_joints(model)), list[int](), foot
    while body not in (root, 0):
        start = int(model.body_jntadr[body])
        joints = [*range(start, start + int(model.body_jntnum[body])), *joints] if start >= 0 else joints
        body = int(model.body_parentid[body])
    return [j for j in joints if int(model.jnt_type[j]) == 3 and (not driven or j in driven)]


def _leg(
    model: mujoco.MjModel, data: mujoco.MjData, foot: int, floor: int, joints: Sequence[int], lateral: np.ndarray
) -> _Leg | None:
    swinging = [j for j in joints if abs(float(data.xaxis[j] @ lateral)) > 0.8]
    if not swinging:
        return None
    points = foot_points(model, data, foot, floor)
    if not len(points):
        return None
    low = points[points[:, 2] < points[:, 2].min() + 0.005]
    flat = min(np.ptp(low[:, 0]), np.ptp(low[:, 1])) > 0.02 and len(joints) > 3
    turn = _rotation(data, foot)
    # A ball turns about its centre without moving on the ground.
    parts = [g for g in geoms_of(model, foot) if can_collide(model, g, floor)]
    lowest = min(parts, key=lambda g: lowest_point(model, data, [g]))
    round_ones = (int(mujoco.mjtGeom.mjGEOM_SPHERE), int(mujoco.mjtGeom.mjGEOM_CAPSULE))
    radius = float(model.geom_size[lowest, 0]) if int(model.geom_type[lowest]) in round_ones and not flat else 0.0
    sole = (low.mean(axis=0) + radius * UP - data.xpos[foot]) @ turn
    level = np.stack([UP, np.cross(lateral, UP)]) @ turn if flat or len(swinging) > 2 else None
    return _Leg(foot, sole, level, tuple(joints), swinging[0], swinging[1] if len(swinging) > 1 else None)


def _bend(
    model: mujoco.MjModel,
    pose: np.ndarray,
    base: np.ndarray,
    leg: _Leg,
    forward: np.ndarray,
    shift: float,
    backward: float,
) -> np.ndarray:
    """Return the pose with one leg bent such that its foot is below its hip, ``shift`` (m) further forward."""
    places = [int(model.jnt_qposadr[j]) for j in leg.joints]
    limited = model.jnt_limited[list(leg.joints)].astype(bool)
    ranges = model.jnt_range[list(leg.joints)]
    spare = 0.02 * (ranges[:, 1] - ranges[:, 0])
    low = np.where(limited, ranges[:, 0] + spare, -np.pi)
    high = np.where(limited, ranges[:, 1] - spare, np.pi)
    rest = np.clip(base[places], low, high)
    data = mujoco.MjData(model)
    knee = leg.knee if leg.knee is not None else leg.hip
    lateral = np.cross(UP, forward)

    def reach(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        data.qpos[:] = pose
        data.qpos[places] = angles
        mujoco.mj_kinematics(model, data)
        turn = _rotation(data, leg.foot)
        level = np.zeros(3)
        if leg.level is not None:
            up, ahead = leg.level @ turn.T
            level = np.array([up[0], up[1], ahead @ lateral])
        return data.xpos[leg.foot] + turn @ leg.sole, level, data.xanchor[leg.hip].copy(), data.xanchor[knee].copy()

    def residual(angles: np.ndarray, length: float | None) -> np.ndarray:
        foot, level, hip, bent = reach(angles)
        along = float((foot - hip) @ forward) - shift
        down = float(hip[2] - foot[2])
        far = 10.0 * (down - length) if length is not None else (down - 3.0)
        knee_off = float((hip - bent) @ forward) - 0.15 * backward
        still = 0.03 * (angles - rest)
        # A leg is bent, not spread.
        aside = 0.0 if length is None else float((foot - straight_foot) @ lateral)
        return np.array([10.0 * along, 3.0 * aside, far, *(3.0 * level), 0.05 * knee_off, *still])

    middle = (low + high) / 2
    starts = [rest, np.where(limited, middle, rest), 0.7 * rest + 0.3 * np.where(limited, middle, rest)]
    for sign in (1.0, -1.0):
        bent = rest.copy()
        bent[leg.joints.index(leg.hip)] += 0.5 * sign
        bent[leg.joints.index(knee)] -= 1.0 * sign
        starts.append(np.clip(bent, low, high))
    straight_foot = np.zeros(3)
    straight = min(
        (fit_within(lambda a: residual(a, None), start, low, high) for start in starts), key=lambda fit: fit[1]
    )
    straight_foot, _, hip, _ = reach(straight[0])
    length = BENT * float(hip[2] - straight_foot[2])
    best = min(
        (fit_within(lambda a: residual(a, length), start, low, high) for start in starts), key=lambda fit: fit[1]
    )
    moved = pose.copy()
    moved[places] = best[0]
    return moved


def _rotation(data: mujoco.MjData, body: int) -> np.ndarray:
    return np.asarray(data.xmat[body]).reshape(3, 3)
