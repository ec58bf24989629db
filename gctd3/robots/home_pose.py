"""The pose in which a robot stands: a key of its file in which it does, else one that is found.

A pose that is found has every foot below its hip, the soles level and the legs bent to 87 % of their length.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from gctd3.robots.actuators import is_position_servo, rest_servos
from gctd3.robots.floating_base import UP
from gctd3.robots.geometry import geom_points, lowest_point
from gctd3.robots.ground import can_collide, geoms_of
from gctd3.robots.mjcf import base_joints, bodies_below, driven_joints

BENT = 0.87  # of a leg's length
_TOUCHING = 0.05  # of the robot's height: how far above the lowest foot another one still stands
_UPRIGHT = np.cos(np.deg2rad(30.0))
_ALIKE = 0.25  # how far the lengths of two legs may differ
_ROUNDS = 40  # of the search for one leg
_STEP = 1e-5  # rad, of numerical derivatives


@dataclass(frozen=True)
class Stance:
    """Describe how a robot stands in a pose.

    Attributes:
        feet: Indices of the bodies that touch the ground once the robot is lowered onto it.
        lift: How far the pose holds its lowest foot above the ground (m).
        height: Height of the robot (m).
        upright: Whether its root is.
    """

    feet: tuple[int, ...]
    lift: float
    height: float
    upright: bool


@dataclass(frozen=True)
class Held:
    """Describe how a robot holds a pose.

    Attributes:
        fell: Time after which it has fallen (s); ``None`` if it stands.
        weak: Indices of the joints whose servos need all of their torque.
        touching: Those of the given sensors that report contact at the end.
    """

    fell: float | None
    weak: tuple[int, ...] = ()
    touching: tuple[int, ...] = ()


def leg_ends(model: mujoco.MjModel, root: int, floor: int) -> list[int]:
    """Return the indices of the bodies at the ends of chains of joints that can touch the floor."""
    touching = [
        b
        for b in bodies_below(model, root)
        if int(model.body_weldid[b]) != int(model.body_weldid[root])
        and any(can_collide(model, g, floor) for g in geoms_of(model, b))
    ]
    inner = {above for body in touching for above in _above(model, body)}
    # What is fixed to a link, as parts of URDFs are, is no farther from the root than the link.
    links = {above for body in touching for above in _above(model, int(model.body_weldid[body]))}
    return [body for body in touching if body not in inner and int(model.body_weldid[body]) not in links]


def _above(model: mujoco.MjModel, body: int) -> list[int]:
    """Return the indices of the bodies between a body and the world."""
    bodies = list[int]()
    while body := int(model.body_parentid[body]):
        bodies.append(body)
    return bodies


def stance(model: mujoco.MjModel, root: int, floor: int, qpos: np.ndarray, ends: Sequence[int]) -> Stance:
    """Return how the robot stands in a pose on those ends of its chains that reach the ground.

    Args:
        model: The model.
        root: Index of the robot's root body.
        floor: Index of the geom that it stands on.
        qpos: The pose, shape ``[nq]``.
        ends: Indices of the bodies that may be feet.
    """
    data = _placed(model, qpos)
    lifts = np.array([_lift(model, data, body, floor) for body in ends])
    lowest = float(lifts.min())
    height = float(data.xpos[bodies_below(model, root), 2].max() - data.geom_xpos[floor, 2]) - lowest
    feet = [body for body, lift in zip(ends, lifts, strict=True) if lift <= lowest + _TOUCHING * max(height, 0.0)]
    reference = _placed(model, model.qpos0)
    turned = data.xmat[root].reshape(3, 3) @ reference.xmat[root].reshape(3, 3).T
    return Stance(tuple(feet), lowest, height, bool(turned[2, 2] > _UPRIGHT))


def like_legs(model: mujoco.MjModel, root: int, ends: Sequence[int], feet: Sequence[int]) -> list[int]:
    """Return the ``ends`` whose chains are built like that of one of the ``feet``: axes alike, links as long."""
    data = _placed(model, model.qpos0)
    shapes = {body: _chain_shape(model, data, root, body) for body in ends}

    def alike(a: int, b: int) -> bool:
        (axes, length), (others, far) = shapes[a], shapes[b]
        if len(axes) != len(others) or abs(length - far) > _ALIKE * max(length, far):
            return False
        return all(abs(float(x @ y)) > 0.8 for x, y in zip(np.abs(axes), np.abs(others), strict=True))

    return [body for body in ends if any(alike(body, foot) for foot in feet)]


def _chain_shape(model: mujoco.MjModel, data: mujoco.MjData, root: int, body: int) -> tuple[list[np.ndarray], float]:
    axes, length = list[np.ndarray](), 0.0
    while body not in (root, 0):
        start = int(model.body_jntadr[body])
        axes += [data.xaxis[j].copy() for j in range(start, start + int(model.body_jntnum[body]))] if start >= 0 else []
        length += float(np.linalg.norm(model.body_pos[body])) if int(model.body_parentid[body]) != root else 0.0
        body = int(model.body_parentid[body])
    return axes, length


def lowest_part(model: mujoco.MjModel, root: int, floor: int, qpos: np.ndarray, feet: Sequence[int]) -> int | None:
    """Return the index of a body of the robot that touches the ground although it is no foot and carries none."""
    data = _placed(model, qpos)
    ground = min(_lift(model, data, body, floor) for body in feet)
    spared = {*feet, *(int(model.body_parentid[foot]) for foot in feet)} - {root}
    for body in bodies_below(model, root):
        if body not in spared and _lift(model, data, body, floor) < ground + 0.002:
            return body
    return None


def below_feet(
    model: mujoco.MjModel, root: int, floor: int, qpos: np.ndarray, feet: Sequence[int]
) -> tuple[int, float] | None:
    """Return the lowest body of the robot, and by how much (m), if it ends clearly below all of the feet.

    Bodies between the root and a foot do not count, nor does what is fixed to a foot.
    """
    data, weld = _placed(model, qpos), model.body_weldid
    fixed = {int(weld[foot]) for foot in feet}
    others = {body for body in bodies_below(model, root) if int(weld[body]) not in fixed}
    others -= {body for foot in feet for body in _above(model, foot)} - {root}
    lifts = {body: _lift(model, data, body, floor) for body in others}
    if not lifts:
        return None
    lowest = min(lifts, key=lambda body: lifts[body])
    depth = min(_lift(model, data, foot, floor) for foot in feet) - lifts[lowest]
    tall = float(data.xpos[bodies_below(model, root), 2].max() - data.geom_xpos[floor, 2]) - lifts[lowest]
    return (lowest, depth) if depth > _TOUCHING * tall else None


def lowered(model: mujoco.MjModel, root: int, qpos: np.ndarray, lift: float) -> np.ndarray:
    """Return a pose moved down by ``lift`` (m); as it is if the root has no joint along z."""
    moved = qpos.copy()
    for joint in base_joints(model, root):
        start, kind = int(model.jnt_qposadr[joint]), int(model.jnt_type[joint])
        if kind == int(mujoco.mjtJoint.mjJNT_FREE):
            moved[start + 2] -= lift
            break
        axis = _placed(model, qpos).xaxis[joint]
        if kind == int(mujoco.mjtJoint.mjJNT_SLIDE) and abs(axis[2]) > 0.999:
            moved[start] -= lift * np.sign(axis[2])
            break
    return moved


def carried_load(model: mujoco.MjModel, qpos: np.ndarray, feet: Sequence[int], floor: int) -> np.ndarray:
    """Return the generalised force with which each degree of freedom carries the standing robot, shape ``[nv]``.

    The ground pushes straight up on the feet, by forces that hold the base and whose squares are least in sum.
    """
    data = _placed(model, qpos)
    mujoco.mj_forward(model, data)
    columns = []
    for body in feet:
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, jacobian, None, _sole(model, data, body, floor), body)
        columns.append(jacobian[2])
    pushes, weight = np.array(columns), data.qfrc_bias.copy()
    root = int(model.body_rootid[feet[0]])
    base = [
        d
        for j in base_joints(model, root)
        for d in range(model.jnt_dofadr[j], model.jnt_dofadr[j] + {0: 6, 1: 3}.get(int(model.jnt_type[j]), 1))
    ]
    forces = np.linalg.lstsq(pushes[:, base].T, weight[base], rcond=None)[0] if base else np.zeros(len(columns))
    return np.asarray(weight - data.qfrc_passive - forces @ pushes)


def carrying_command(model: mujoco.MjModel, qpos: np.ndarray, feet: Sequence[int], floor: int) -> np.ndarray:
    """Return the desired angle of each servo whose error carries the robot's weight in a pose, shape ``[nu]`` (rad)."""
    joints, load = driven_joints(model), carried_load(model, qpos, feet, floor)
    torque = load[[int(model.jnt_dofadr[j]) for j in joints]]
    limited = model.actuator_forcelimited.astype(bool)
    low, high = np.where(limited, model.actuator_forcerange.T, [[-np.inf], [np.inf]])
    home = qpos[[int(model.jnt_qposadr[j]) for j in joints]]
    command = home + np.clip(torque, low, high) / model.actuator_gainprm[:, 0]
    return np.asarray(np.clip(command, *model.actuator_ctrlrange.T))


def clipped(model: mujoco.MjModel, qpos: np.ndarray, joints: Sequence[int]) -> tuple[np.ndarray, list[int]]:
    """Return a pose with the given joints in their ranges and those of their servos, and which of them were outside."""
    moved, outside = qpos.copy(), list[int]()
    servos = {int(model.actuator_trnid[i, 0]): i for i in range(model.nu) if is_position_servo(model, i)}
    for joint in joints:
        if int(model.jnt_type[joint]) not in (2, 3):
            continue
        start = int(model.jnt_qposadr[joint])
        place = float(qpos[start])
        if model.jnt_limited[joint]:
            place = float(np.clip(place, *model.jnt_range[joint]))
        servo = servos.get(joint)
        if servo is not None and model.actuator_ctrllimited[servo] and float(model.actuator_gear[servo, 0]) == 1.0:
            place = float(np.clip(place, *model.actuator_ctrlrange[servo]))
        if abs(place - qpos[start]) > 1e-4:
            outside.append(joint)
            moved[start] = place
    return moved, outside


def holds(
    model: mujoco.MjModel,
    qpos: np.ndarray,
    root: int,
    sensors: Sequence[int] = (),
    seconds: float = 3.0,
    command: np.ndarray | None = None,
) -> Held:
    """Simulate servos that hold a pose and tell how long the robot stands, and which servos need all of their torque.

    Args:
        model: The model; its actuators are position servos.
        qpos: The pose, shape ``[nq]``.
        root: Index of the robot's root body.
        sensors: Indices in ``sensordata`` of sensors of contact.
        seconds: How long to simulate (s).
        command: Desired angle of each servo, shape ``[nu]`` (rad); those of the pose if ``None``.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    rest_servos(model, data)
    joints = driven_joints(model)
    data.ctrl[:] = [qpos[int(model.jnt_qposadr[j])] for j in joints] if command is None else command
    mujoco.mj_forward(model, data)
    height, upright = float(data.xpos[root, 2]), data.xmat[root].reshape(3, 3).copy()
    floor = height - float(data.geom_xpos[:, 2].min())
    limit = np.where(model.actuator_forcelimited.astype(bool), np.abs(model.actuator_forcerange).min(axis=1), np.inf)
    used, steps = np.zeros(model.nu), max(1, round(seconds / model.opt.timestep))
    for step in range(steps):
        mujoco.mj_step(model, data)
        turned = data.xmat[root].reshape(3, 3) @ upright.T
        if (
            data.time < step * model.opt.timestep
            or turned[2, 2] < _UPRIGHT
            or data.xpos[root, 2] < height - 0.3 * floor
        ):
            return Held((step + 1) * model.opt.timestep, ())
        if step >= steps // 2:
            used += np.abs(data.actuator_force) > 0.98 * limit
    weak = tuple(int(i) for i in np.flatnonzero(used > 0.8 * (steps - steps // 2)))
    return Held(None, tuple(joints[i] for i in weak), tuple(a for a in sensors if data.sensordata[a] > 0))


# Search.


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
    data = _placed(model, base)
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
        data = _placed(model, pose)
        mujoco.mj_comPos(model, data)
        places = np.array([data.xpos[leg.foot] + _turn(data, leg.foot) @ leg.sole for leg in chosen]) @ forward
        middle = float(data.subtree_com[root] @ forward)
        low, high = float(places.min()), float(places.max())
        spare = 0.25 * (high - low)
        # A robot on two legs balances above their middle; on more, well between the first and the last.
        target = float(places.mean()) if len(feet) == 2 else float(np.clip(middle, low + spare, high - spare))
        if abs(middle - target) < 1e-3:
            break
        shift += middle - target
    pose = _alike(model, pose, chosen, lateral, forward)
    return lowered(model, root, pose, min(_lift(model, _placed(model, pose), foot, floor) for foot in feet))


def _alike(
    model: mujoco.MjModel, pose: np.ndarray, legs: Sequence[_Leg], lateral: np.ndarray, forward: np.ndarray
) -> np.ndarray:
    """Return a pose in which legs that stand beside each other have equal or opposite angles, to a thousandth."""
    data, even = _placed(model, pose), pose.copy()
    places = [data.xpos[leg.foot] + _turn(data, leg.foot) @ leg.sole for leg in legs]
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
    points = _foot_points(model, data, foot, floor)
    if not len(points):
        return None
    low = points[points[:, 2] < points[:, 2].min() + 0.005]
    flat = min(np.ptp(low[:, 0]), np.ptp(low[:, 1])) > 0.02 and len(joints) > 3
    turn = _turn(data, foot)
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
        turn = _turn(data, leg.foot)
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
    straight = min((_fit(lambda a: residual(a, None), start, low, high) for start in starts), key=lambda fit: fit[1])
    straight_foot, _, hip, _ = reach(straight[0])
    length = BENT * float(hip[2] - straight_foot[2])
    best = min((_fit(lambda a: residual(a, length), start, low, high) for start in starts), key=lambda fit: fit[1])
    moved = pose.copy()
    moved[places] = best[0]
    return moved


def _fit(
    residual: Callable[[np.ndarray], np.ndarray], start: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, float]:
    """Minimise a sum of squares within bounds (Levenberg and Marquardt); return where, and how small."""
    angles, values, damping = start.copy(), residual(start), 1e-3
    for _ in range(_ROUNDS):
        columns = [(residual(angles + step) - values) / _STEP for step in _STEP * np.eye(len(angles))]
        jacobian = np.stack(columns, axis=1)
        gradient = jacobian.T @ values
        # At a bound only steps inwards count.
        free = ~(((angles <= low) & (gradient > 0)) | ((angles >= high) & (gradient < 0)))
        if not free.any():
            break
        normal = jacobian[:, free].T @ jacobian[:, free]
        step = np.zeros(len(angles))
        step[free] = -np.linalg.solve(normal + damping * np.eye(int(free.sum())), gradient[free])
        tried = np.clip(angles + np.clip(step, -0.5, 0.5), low, high)
        new = residual(tried)
        if new @ new < values @ values:
            done = values @ values - new @ new < 1e-12
            angles, values, damping = tried, new, max(damping / 3, 1e-9)
            if done:
                break
        else:
            damping *= 4
            if damping > 1e6:
                break
    return angles, float(values @ values)


def _placed(model: mujoco.MjModel, qpos: np.ndarray) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    return data


def _turn(data: mujoco.MjData, body: int) -> np.ndarray:
    return np.asarray(data.xmat[body]).reshape(3, 3)


def _foot_points(model: mujoco.MjModel, data: mujoco.MjData, body: int, floor: int) -> np.ndarray:
    parts = [geom_points(model, data, g) for g in geoms_of(model, body) if can_collide(model, g, floor)]
    return np.concatenate(parts) if parts else np.zeros((0, 3))


def _sole(model: mujoco.MjModel, data: mujoco.MjData, body: int, floor: int) -> np.ndarray:
    points = _foot_points(model, data, body, floor)
    return np.asarray(points[points[:, 2] < points[:, 2].min() + 0.005].mean(axis=0))


def _lift(model: mujoco.MjModel, data: mujoco.MjData, body: int, floor: int) -> float:
    """Return how far the lowest point of a body is above the floor (m)."""
    points = _foot_points(model, data, body, floor)
    if not len(points):
        return np.inf
    if int(model.geom_type[floor]) == int(mujoco.mjtGeom.mjGEOM_HFIELD):
        return float((points[:, 2] - _terrain(model, data, floor, points[:, :2])).min())
    thick = model.geom_size[floor, 2] if int(model.geom_type[floor]) == int(mujoco.mjtGeom.mjGEOM_BOX) else 0.0
    return float(points[:, 2].min() - data.geom_xpos[floor, 2] - thick)


def _terrain(model: mujoco.MjModel, data: mujoco.MjData, floor: int, places: np.ndarray) -> np.ndarray:
    """Return the height of a height field at places ``[K, 2]`` (m)."""
    index = int(model.geom_dataid[floor])
    rows, columns = int(model.hfield_nrow[index]), int(model.hfield_ncol[index])
    start = int(model.hfield_adr[index])
    heights = model.hfield_data[start : start + rows * columns].reshape(rows, columns)
    half, centre = model.hfield_size[index], data.geom_xpos[floor]
    local = (places - centre[:2]) @ data.geom_xmat[floor].reshape(3, 3)[:2, :2]
    column = np.clip((local[:, 0] / half[0] + 1) / 2 * (columns - 1), 0, columns - 1)
    row = np.clip((local[:, 1] / half[1] + 1) / 2 * (rows - 1), 0, rows - 1)
    c, r = np.minimum(column.astype(int), columns - 2), np.minimum(row.astype(int), rows - 2)
    x, y = column - c, row - r
    blended = (heights[r, c] * (1 - x) + heights[r, c + 1] * x) * (1 - y)
    blended += (heights[r + 1, c] * (1 - x) + heights[r + 1, c + 1] * x) * y
    return np.asarray(centre[2] + half[2] * blended)
