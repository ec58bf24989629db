"""Position servos for a robot whose file has motors, other actuators or none: gains, torque limits and ranges.

Derived gains follow mjlab (Zakka et al. 2025): a servo of natural frequency 10 Hz and damping ratio 2 on the inertia
of the joint's rotor; without one, on the robot's inertia about the joint in its standing pose.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import mujoco
import numpy as np

from gctd3.errors import RobotError
from gctd3.robots.actuators import is_position_servo
from gctd3.robots.draft import Draft, first_fitting, listed, spread
from gctd3.robots.mjcf import joint_kind, joint_name
from gctd3.robots.servo_settings import ServoSettings

FREQUENCY = 2 * np.pi * 10.0  # rad/s
DAMPING_RATIO = 2.0
MOST_SAG = 0.1  # rad: the most by which a joint may give way under the standing robot
FULL_EFFORT = (0.6, 1.5)  # rad: an error between these two asks for all of the torque
_TRANSMISSIONS = {int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)}


@dataclass(frozen=True)
class _Drive:
    """Describe the action of the file's actuator on its joint, per unit of the joint's angle.

    Attributes:
        stiffness: Torque per radian; ``None`` if it is no position servo.
        damping: Torque per unit of velocity; ``None`` if it has none of its own.
        low: Least torque (N m).
        high: Largest torque (N m).
        range: Desired angles (rad); ``None`` if the file sets none.
    """

    stiffness: float | None = None
    damping: float | None = None
    low: float = -np.inf
    high: float = np.inf
    range: tuple[float, float] | None = None


def complete_servos(
    draft: Draft,
    qpos: np.ndarray,
    load: np.ndarray,
    asked: Mapping[str, ServoSettings],
    limits: Mapping[str, ServoSettings],
) -> None:
    """Give every driven joint one position servo with a range; all hinges are driven if the file has no actuator.

    Args:
        draft: The file.
        qpos: The standing pose, shape ``[nq]``.
        load: Torque that each degree of freedom needs to stand, shape ``[nv]`` (N m).
        asked: Servos by pattern of joints, as the settings ask for; the first that fits counts.
        limits: Limits that the file gives for servos and MJCF has no place for, by the joint's name.

    Raises:
        RobotError: If a range cannot be one of angles.
    """
    drop_actuators(draft)
    model = draft.model
    own = draft.joints()
    elements = {joint_id(model, a.target): a for a in draft.spec.actuators}
    if not elements:
        elements = _add_actuators(draft, [j for j in own if joint_kind(model, j) == "hinge"])
    gains = _Gains(model, qpos, load, list(elements))
    made: dict[str, list[tuple[str, float, float]]] = {}
    moved, speeds, endless = list[str](), list[str](), list[str]()
    for joint, actuator in elements.items():
        if joint_kind(model, joint) != "hinge":
            continue
        name = joint_name(model, joint)
        drive, old = _read(model, joint)
        _check_range(draft, model, joint, actuator.name or name, drive.range)
        wanted = _merged(first_fitting(asked, name), limits.get(name))
        if wanted.velocity_limit is not None:
            speeds.append(name)
        wanted = replace(wanted, velocity_limit=None)
        if model.jnt_actfrclimited[joint]:
            draft.edit()
            element = draft.spec_joint(joint)
            element.actfrclimited, element.actfrcrange = mujoco.mjtLimited.mjLIMITED_FALSE, [0.0, 0.0]
            actuator.forcelimited, actuator.forcerange = mujoco.mjtLimited.mjLIMITED_TRUE, [drive.low, drive.high]
            moved.append(name)
        fine = old is not None and is_position_servo(model, old) and float(model.actuator_gear[old, 0]) == 1.0
        if fine and drive.range is not None and wanted == ServoSettings():
            continue
        draft.edit()
        if wanted.armature is not None:
            draft.spec_joint(joint).armature = wanted.armature
        if wanted.effort is not None:
            drive = replace(drive, low=-wanted.effort, high=wanted.effort)
        stiffness = wanted.stiffness if wanted.stiffness is not None else drive.stiffness
        derived = stiffness is None
        if stiffness is None:
            stiffness = gains.stiffness(joint, min(-drive.low, drive.high), wanted.armature)
        damping = wanted.damping if wanted.damping is not None else drive.damping
        if damping is None:
            damping = float(f"{stiffness * 2 * DAMPING_RATIO / FREQUENCY:.3g}")
        angles = _range_of(model, joint, drive.range, float(qpos[int(model.jnt_qposadr[joint])]))
        if drive.range is None and not model.jnt_limited[joint]:
            endless.append(name)
        _write(actuator, stiffness, damping, (drive.low, drive.high), angles)
        what = _sentence(model, old, drive, derived, wanted)
        made.setdefault(what, []).append((name, stiffness, damping))
    for what, servos in made.items():
        stiff, damped = spread([k for _, k, _ in servos]), spread([d for *_, d in servos])
        names = listed([name for name, *_ in servos])
        draft.edit(f"{what.format(joints=names)}: stiffness {stiff} N m/rad, damping {damped} N m s/rad.")
    if moved:
        draft.edit(
            f"The torque limits of {listed(moved)} are their servos' now: MuJoCo slows a servo at a joint's limit."
        )
    if endless:
        draft.edit(f"Without ranges, their servos turn {listed(endless)} by half a turn from the standing pose.")
    if speeds:
        draft.edit(f"The velocity limits of {listed(speeds)} are not simulated: MuJoCo's servos have none.")
    _check_integrator(draft, gains.inertia)


def _merged(asked: ServoSettings | None, stated: ServoSettings | None) -> ServoSettings:
    """Return a servo's settings, with the file's values for those that are ``None``."""
    first, second = asked or ServoSettings(), stated or ServoSettings()
    values = {f.name: getattr(first, f.name) for f in fields(ServoSettings)}
    return ServoSettings(**{n: v if v is not None else getattr(second, n) for n, v in values.items()})


def _check_integrator(draft: Draft, inertia: np.ndarray) -> None:
    """Change the integrator if it cannot take the damping of the servos, which Euler's method adds explicitly."""
    model, spec = draft.model, draft.spec
    if model.opt.integrator != mujoco.mjtIntegrator.mjINT_EULER:
        return
    for actuator in spec.actuators:
        joint = joint_id(model, actuator.target)
        damping = -float(actuator.biasprm[2]) * float(actuator.gear[0]) ** 2
        if damping * model.opt.timestep > inertia[int(model.jnt_dofadr[joint])]:
            spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
            # Files for MuJoCo's accelerated versions ask for one or two, with which it diverges.
            spec.option.iterations = max(int(spec.option.iterations), 20)
            spec.option.ls_iterations = max(int(spec.option.ls_iterations), 20)
            draft.edit("The integrator is implicitfast instead of Euler, which the damping of the servos would upset.")
            return


def joint_id(model: mujoco.MjModel, name: str) -> int:
    """Return the index of a joint by the name that :func:`.joint_name` gives it."""
    return next(j for j in range(model.njnt) if joint_name(model, j) == name)


def drop_actuators(draft: Draft) -> None:
    """Drop the actuators that drive no joint of the robot, and all but one of several that drive the same joint."""
    model, own = draft.model, set(draft.joints())
    by_joint: dict[int, list[int]] = {}
    dropped: dict[str, list[int]] = {}
    for i in range(model.nu):
        if int(model.actuator_trntype[i]) not in _TRANSMISSIONS:
            kind = mujoco.mjtTrn(int(model.actuator_trntype[i])).name.removeprefix("mjTRN_").lower()
            dropped.setdefault(f"a {kind} instead of a joint", []).append(i)
        elif int(model.actuator_trnid[i, 0]) not in own:
            dropped.setdefault(f"no joint below {draft.root_name}", []).append(i)
        else:
            by_joint.setdefault(int(model.actuator_trnid[i, 0]), []).append(i)
    for several in by_joint.values():
        # A position servo, else a motor; its companions for other modes of control are never told anything.
        several.sort(key=lambda i: (not is_position_servo(model, i), model.actuator_biastype[i] != 0, i))
        if several[1:]:
            dropped.setdefault("a joint that another actuator drives", []).extend(several[1:])
    if not dropped:
        return
    names = {i: model.actuator(i).name or str(i) for i in range(model.nu)}
    for why, gone in dropped.items():
        draft.edit(f"Actuator {listed([names[i] for i in gone])} is left out: it drives {why}.")
    remove_actuators(draft, [i for gone in dropped.values() for i in gone])
    draft.compile()


def remove_actuators(draft: Draft, gone: Sequence[int]) -> None:
    """Remove actuators of the file by their index, with what refers to them; keys keep the others' numbers."""
    spec, model = draft.spec, draft.model
    names = {model.actuator(i).name for i in gone}
    for sensor in list(spec.sensors):
        actuator = int(mujoco.mjtObj.mjOBJ_ACTUATOR)
        if (sensor.objtype == actuator and sensor.objname in names) or (
            sensor.reftype == actuator and sensor.refname in names
        ):
            spec.delete(sensor)
    rest = [i for i in range(model.nu) if i not in gone]
    acts = [a for i in rest for a in range(model.actuator_actadr[i], model.actuator_actadr[i] + _count(model, i))]
    for key in spec.keys:
        if len(key.ctrl) == model.nu:
            key.ctrl = np.array(key.ctrl)[rest]
        if len(key.act) == model.na:
            key.act = np.array(key.act)[acts]
    for element in [spec.actuators[i] for i in sorted(gone)]:
        spec.delete(element)


def _count(model: mujoco.MjModel, actuator: int) -> int:
    return int(model.actuator_actnum[actuator]) if model.actuator_actadr[actuator] >= 0 else 0


def _add_actuators(draft: Draft, joints: Sequence[int]) -> dict[int, mujoco.MjsActuator]:
    """Add an actuator for each joint that no other joint's equality moves."""
    model, added = draft.model, dict[int, mujoco.MjsActuator]()
    follow = model.eq_obj1id[model.eq_type == mujoco.mjtEq.mjEQ_JOINT].tolist()
    draft.edit()
    for joint in joints:
        if joint not in follow:
            name = joint_name(model, joint)
            added[joint] = draft.spec.add_actuator(
                name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, gaintype=mujoco.mjtGain.mjGAIN_FIXED
            )
    return added


def _read(model: mujoco.MjModel, joint: int) -> tuple[_Drive, int | None]:
    """Read the action of an actuator on its joint, and its index in the model, ``None`` if it is a new one."""
    low, high = -np.inf, np.inf
    if model.jnt_actfrclimited[joint]:
        low, high = (float(v) for v in model.jnt_actfrcrange[joint])
    old = next((i for i in _joint_actuators(model) if int(model.actuator_trnid[i, 0]) == joint), None)
    if old is None:
        return _Drive(low=low, high=high), None
    gear, gain, bias = float(model.actuator_gear[old, 0]), model.actuator_gainprm[old], model.actuator_biasprm[old]
    gear = gear if gear != 0.0 else 1.0
    if model.actuator_forcelimited[old]:
        own = sorted(float(v) * gear for v in model.actuator_forcerange[old])
        low, high = max(low, own[0]), min(high, own[1])
    affine = int(model.actuator_biastype[old]) == int(mujoco.mjtBias.mjBIAS_AFFINE)
    limited, span = bool(model.actuator_ctrllimited[old]), model.actuator_ctrlrange[old]
    if affine and bias[1] < 0.0:
        # It comes to rest at the desired angle.
        per_angle = gear * float(bias[1] / -gain[0]) if gain[0] else gear
        stiffness, damping = -float(bias[1]) * gear**2, 0.0 - float(bias[2]) * gear**2
        place = sorted(float(v) / per_angle for v in span)
        return _Drive(stiffness, damping, low, high, (place[0], place[1]) if limited else None), old
    if not affine and limited and int(model.actuator_gaintype[old]) == int(mujoco.mjtGain.mjGAIN_FIXED):
        own = sorted(float(v * gain[0]) * gear for v in span)
        if own[0] < 0.0 < own[1]:
            low, high = max(low, own[0]), min(high, own[1])
    return _Drive(low=low, high=high), old


def _joint_actuators(model: mujoco.MjModel) -> list[int]:
    return [i for i in range(model.nu) if int(model.actuator_trntype[i]) in _TRANSMISSIONS]


class _Gains:
    """Derive stiffnesses for which the torque suffices and the joints hardly give way under the robot.

    Joints of one kind, such as the knees, get equal ones: as many joints above them and axes alike. Rotors that were
    identified one by one differ; their median counts.

    Args:
        model: The model.
        qpos: The standing pose, shape ``[nq]``.
        load: Torque that each degree of freedom needs to stand, shape ``[nv]`` (N m).
        joints: Indices of the joints that are driven.
    """

    def __init__(self, model: mujoco.MjModel, qpos: np.ndarray, load: np.ndarray, joints: Sequence[int]) -> None:
        data = mujoco.MjData(model)
        data.qpos[:] = qpos
        mujoco.mj_forward(model, data)
        inverse = np.zeros((model.nv, model.nv))
        mujoco.mj_solveM(model, data, inverse, np.eye(model.nv))
        # What a joint feels of the robot with all others free (kg m^2).
        self.inertia = 1.0 / np.maximum(np.diag(inverse), 1e-12)
        self.model, self.load = model, np.abs(load)
        mujoco.mj_resetData(model, data)
        mujoco.mj_kinematics(model, data)
        self._dofs = [int(model.jnt_dofadr[j]) for j in joints]
        self._kinds = {j: self._kind(j, data.xaxis[j]) for j in joints}

    def _kind(self, joint: int, axis: np.ndarray) -> tuple[object, ...]:
        depth, body = joint - int(self.model.body_jntadr[self.model.jnt_bodyid[joint]]), self.model.jnt_bodyid[joint]
        while body := int(self.model.body_parentid[body]):
            depth += int(self.model.body_jntnum[body])
        return depth, tuple(np.abs(axis).round(1).tolist())

    def stiffness(self, joint: int, effort: float, rotor: float | None) -> float:
        """Return the stiffness of a joint's servo (N m/rad).

        Args:
            joint: Index of the joint.
            effort: Largest torque (N m), may be infinite.
            rotor: Inertia of its rotor (kg m^2); the file's if ``None``.
        """
        alike = [int(self.model.jnt_dofadr[j]) for j, kind in self._kinds.items() if kind == self._kinds[joint]]
        armature = rotor if rotor is not None else float(np.median(self.model.dof_armature[alike]))
        inertia = armature if armature > 0 else float(self.inertia[alike].max())
        least = float(self.load[alike].max()) / MOST_SAG
        # What is idle while the robot stands upright has its share as soon as it does not.
        least = max(least, min(0.5 * float(self.load[self._dofs].max()) / MOST_SAG, effort / FULL_EFFORT[0]))
        if np.isfinite(effort):
            least = max(least, effort / FULL_EFFORT[1])
        most = max(effort / FULL_EFFORT[0], least)
        return float(f"{min(max(inertia * FREQUENCY**2, least), most):.3g}")


def _range_of(
    model: mujoco.MjModel, joint: int, written: tuple[float, float] | None, home: float
) -> tuple[float, float]:
    if written is not None:
        return written
    if model.jnt_limited[joint]:
        low, high = (float(v) for v in model.jnt_range[joint])
        return low, high
    return home - np.pi, home + np.pi


def _check_range(
    draft: Draft, model: mujoco.MjModel, joint: int, name: str, written: tuple[float, float] | None
) -> None:
    """Check that a servo's range can be one of its joint's angles: degrees are 57 times as many."""
    if written is None or not model.jnt_limited[joint]:
        return
    low, high = (float(v) for v in model.jnt_range[joint])
    spare = max(2 * np.pi, high - low)
    if written[0] < low - spare or written[1] > high + spare:
        raise RobotError(
            f"{draft.file}: the ctrlrange of actuator {name!r}, {written[0]:g} to {written[1]:g} rad, lies far outside "
            f"of the range of joint {joint_name(model, joint)!r}, {low:.4g} to {high:.4g} rad; a ctrlrange is in "
            "radians for any compiler's angle."
        )


def _write(
    actuator: mujoco.MjsActuator,
    stiffness: float,
    damping: float,
    force: tuple[float, float],
    angles: tuple[float, float],
) -> None:
    """Make an actuator a position servo; one that filters its desired angle keeps its time constant."""
    filtered = (mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT)
    if actuator.dyntype not in filtered:
        actuator.dyntype = mujoco.mjtDyn.mjDYN_NONE
        actuator.actlimited, actuator.actdim = mujoco.mjtLimited.mjLIMITED_FALSE, -1
    actuator.gaintype, actuator.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
    actuator.gainprm = [stiffness, *[0.0] * (len(actuator.gainprm) - 1)]
    actuator.biasprm = [0.0, -stiffness, -damping, *[0.0] * (len(actuator.biasprm) - 3)]
    actuator.gear = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    actuator.inheritrange = 0.0
    actuator.ctrllimited, actuator.ctrlrange = mujoco.mjtLimited.mjLIMITED_TRUE, list(angles)
    if np.isfinite(force).all():
        actuator.forcelimited, actuator.forcerange = mujoco.mjtLimited.mjLIMITED_TRUE, list(force)


def _sentence(model: mujoco.MjModel, old: int | None, drive: _Drive, derived: bool, wanted: ServoSettings) -> str:
    """Return the sentence about a servo that was made or changed, up to its gains."""
    gains = "derived gains" if derived else "the given gains"
    if old is None:
        return f"Position servos with {gains} are added for {{joints}}"
    if drive.stiffness is None:
        return f"The actuators of {{joints}} are position servos with {gains} now"
    if wanted != ServoSettings():
        return "The servos of {joints} are as the settings ask for"
    if not is_position_servo(model, old):
        return "The actuators of {joints} are position servos with their own gains now"
    if float(model.actuator_gear[old, 0]) != 1.0:
        return "The servos of {joints} count in angles of their joints, without a gear"
    return "The servos of {joints} get the ranges of their joints"
