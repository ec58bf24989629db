"""Joints that are held: they are removed from the file, with the bodies below them turned as the pose has them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase

import mujoco
import numpy as np

from gctd3.errors import RobotError
from gctd3.robots.draft import Draft, check_patterns, listed
from gctd3.robots.mjcf import joint_kind, joint_name
from gctd3.robots.servos import remove_actuators


def hold_joints(draft: Draft, patterns: Sequence[str], pose: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Remove joints from the file and fix their bodies where the pose has them; return the joints' angles (rad; m).

    Args:
        draft: The file.
        patterns: Patterns (``*`` and ``?``) of the joints.
        pose: The standing pose by the joints' names.

    Raises:
        RobotError: If a pattern fits no joint of the robot, or a joint cannot be removed.
    """
    model = draft.model
    own = draft.joints()
    names = {joint_name(model, j): j for j in own}
    check_patterns(patterns, list(names), "robot.hold", draft.file)
    chosen = {n: j for n, j in names.items() if any(fnmatchcase(n, pattern) for pattern in patterns)}
    if not chosen:
        return {}
    if len(chosen) == len(names):
        raise RobotError(f"{draft.file}: robot.hold leaves the robot no joint.")
    draft.edit()
    # Found first: removals change the indices.
    parts = {j: (draft.spec_joint(j), draft.spec_body(int(model.jnt_bodyid[j]))) for j in chosen.values()}
    order = {joint.name: joint.id for joint in draft.spec.joints}
    keys = [(key, _poses(model, key)) for key in draft.spec.keys]
    transmission = mujoco.mjtTrn
    on_joint = (int(transmission.mjTRN_JOINT), int(transmission.mjTRN_JOINTINPARENT))
    gone = [
        i
        for i in range(model.nu)
        if int(model.actuator_trntype[i]) in on_joint and int(model.actuator_trnid[i, 0]) in chosen.values()
    ]
    remove_actuators(draft, gone)
    _remove_references(draft, set(chosen))
    for name, joint in chosen.items():
        _fix(draft, parts[joint], joint, np.asarray(pose[name], dtype=float), order)
    for key, (qpos, qvel) in keys:
        key.qpos = np.concatenate([values for name, values in qpos.items() if name not in chosen])
        key.qvel = np.concatenate([values for name, values in qvel.items() if name not in chosen])
    held = {name: float(pose[name][0]) for name in chosen if joint_kind(model, chosen[name]) != "ball"}
    draft.edit(f"Held in the standing pose, as robot.hold asks: {listed(list(chosen))}.")
    draft.compile()
    return held


def _poses(model: mujoco.MjModel, key: mujoco.MjsKey) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return a key's positions and velocities by the joints' names."""
    index = int(key.id)
    q, v = model.key_qpos[index].copy(), model.key_qvel[index].copy()
    wide, deep = {0: 7, 1: 4}, {0: 6, 1: 3}
    qpos, qvel = {}, {}
    for j in range(model.njnt):
        kind, name = int(model.jnt_type[j]), joint_name(model, j)
        a, b = int(model.jnt_qposadr[j]), int(model.jnt_dofadr[j])
        qpos[name], qvel[name] = q[a : a + wide.get(kind, 1)], v[b : b + deep.get(kind, 1)]
    return qpos, qvel


def _remove_references(draft: Draft, names: set[str]) -> None:
    """Remove the sensors, equalities and tendons that are about joints which are removed."""
    spec, model = draft.spec, draft.model
    kind = mujoco.mjtObj.mjOBJ_JOINT
    tendons = set()
    joints = {joint_name(model, j): j for j in range(model.njnt)}
    ids = {joints[name] for name in names}
    for tendon in range(model.ntendon):
        start = int(model.tendon_adr[tendon])
        wraps = range(start, start + int(model.tendon_num[tendon]))
        fixed = int(mujoco.mjtWrap.mjWRAP_JOINT)
        if any(int(model.wrap_type[w]) == fixed and int(model.wrap_objid[w]) in ids for w in wraps):
            tendons.add(model.tendon(tendon).name)
    for equality in list(spec.equalities):
        about = {equality.name1, equality.name2}
        on_joints = equality.type == mujoco.mjtEq.mjEQ_JOINT and about & names
        if on_joints or (equality.type == mujoco.mjtEq.mjEQ_TENDON and about & tendons):
            spec.delete(equality)
    for sensor in list(spec.sensors):
        if (sensor.objtype == kind and sensor.objname in names) or (
            sensor.objtype == mujoco.mjtObj.mjOBJ_TENDON and sensor.objname in tendons
        ):
            spec.delete(sensor)
    driving = [
        i
        for i in range(model.nu)
        if int(model.actuator_trntype[i]) == int(mujoco.mjtTrn.mjTRN_TENDON)
        and model.tendon(int(model.actuator_trnid[i, 0])).name in tendons
    ]
    if driving:
        still = {model.actuator(i).name for i in driving}
        for actuator in [a for a in spec.actuators if a.name in still]:
            spec.delete(actuator)
        for key in spec.keys:
            key.ctrl, key.act = [], []
    for tendon in [t for t in spec.tendons if t.name in tendons]:
        spec.delete(tendon)


def _fix(
    draft: Draft,
    part: tuple[mujoco.MjsJoint, mujoco.MjsBody],
    joint: int,
    place: np.ndarray,
    order: Mapping[str, int],
) -> None:
    """Remove one joint; the place of its body, and the other joints of that body, are such that nothing else moves."""
    spec, model = draft.spec, draft.model
    element, body = part
    turn, shift = _motion(model, joint, place)
    inverse = np.zeros(4)
    mujoco.mju_negQuat(inverse, turn)
    # Joints of the body that come before are now applied after the fixed motion.
    for other in body.joints:
        if order[other.name] < joint:
            other.axis = _rotated(inverse, np.array(other.axis))
            other.pos = _rotated(inverse, np.array(other.pos) - shift)
    quat = _quaternion(spec, body)
    body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    body.pos = np.array(body.pos) + _rotated(quat, shift)
    turned = np.zeros(4)
    mujoco.mju_mulQuat(turned, quat, turn)
    body.quat = turned
    spec.delete(element)


def _motion(model: mujoco.MjModel, joint: int, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rotation (a quaternion) and shift (m) of a joint's body, in the body's own frame."""
    turn = np.array([1.0, 0.0, 0.0, 0.0])
    kind, start = joint_kind(model, joint), int(model.jnt_qposadr[joint])
    axis, anchor = model.jnt_axis[joint], model.jnt_pos[joint]
    if kind == "slide":
        return turn, axis * float(place[0] - model.qpos0[start])
    if kind == "ball":
        turn = place / np.linalg.norm(place)
    else:
        mujoco.mju_axisAngle2Quat(turn, axis, float(place[0] - model.qpos0[start]))
    return turn, anchor - _rotated(turn, anchor)


def _rotated(quat: np.ndarray, vector: np.ndarray) -> np.ndarray:
    result = np.zeros(3)
    mujoco.mju_rotVecQuat(result, np.asarray(vector, dtype=float), quat)
    return result


def _quaternion(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> np.ndarray:
    """Return a body's orientation within its parent or its frame, however the file writes it."""
    if body.alt.type == mujoco.mjtOrientation.mjORIENTATION_QUAT:
        quat = np.array(body.quat, dtype=float)
        return quat / np.linalg.norm(quat)
    degree, sequence = spec.compiler.degree, spec.compiler.eulerseq
    return np.array(spec.resolve_orientation(degree=degree, sequence=sequence, orientation=body.alt))
