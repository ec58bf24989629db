"""The walking task's requirements on actuators: position servos, one to a joint; and their state at rest."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from gctd3.errors import RobotError
from gctd3.robots.mjcf import Joint, joint_name

if TYPE_CHECKING:
    from gctd3.robots.robot import Robot


def filters() -> tuple[int, int]:
    """Return the kinds of actuator dynamics that filter the control."""
    return int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT)


def torque_limit(robot: Robot, index: int) -> float:
    """Return the largest torque of an actuator (N m), infinite for none: the lower of its own and its joint's limit."""
    model, joint = robot.model, robot.joint(robot.actuated[index])
    limits = [np.inf]
    if model.actuator_forcelimited[index]:
        limits.append(float(np.abs(model.actuator_forcerange[index]).max()))
    if model.jnt_actfrclimited[joint.id]:
        limits.append(float(np.abs(model.jnt_actfrcrange[joint.id]).max()))
    return min(limits)


def check_servos(model: mujoco.MjModel, joints: Sequence[Joint], file: Path) -> None:
    """Check that every actuator is a position servo with a range, and drives a joint that no other does.

    Args:
        model: The model.
        joints: The robot's joints.
        file: Path of the MJCF, for messages.

    Raises:
        RobotError: If an actuator is something else, or the model has no actuator; the message names it.
    """
    if model.nu == 0:
        raise RobotError(f"{file} has no actuator: add a <position> for every joint that the policy is to move.")
    ids, driving = {joint.id for joint in joints}, dict[int, str]()
    for i in range(model.nu):
        name, joint = model.actuator(i).name or str(i), int(model.actuator_trnid[i, 0])
        if model.actuator_trntype[i] != mujoco.mjtTrn.mjTRN_JOINT:
            raise RobotError(f"{file}: actuator {name!r} does not drive a joint.")
        driven = joint_name(model, joint)
        if joint not in ids:
            raise RobotError(f"{file}: actuator {name!r} drives {driven!r}, which is not a joint below the root.")
        if not is_position_servo(model, i):
            raise RobotError(f"{file}: actuator {name!r} must be a <position> servo: actions are desired angles.")
        if not model.actuator_ctrllimited[i]:
            raise RobotError(f"{file}: actuator {name!r} needs a ctrlrange (rad), onto which actions are mapped.")
        if joint in driving:
            raise RobotError(
                f"{file}: actuators {driving[joint]!r} and {name!r} both drive joint {driven!r}: leave one of them."
            )
        driving[joint] = name


def is_position_servo(model: mujoco.MjModel, actuator: int) -> bool:
    """Tell whether an actuator is a position servo, with or without a filter before it."""
    gain, bias = model.actuator_gainprm[actuator], model.actuator_biasprm[actuator]
    return bool(
        int(model.actuator_gaintype[actuator]) == int(mujoco.mjtGain.mjGAIN_FIXED)
        and int(model.actuator_biastype[actuator]) == int(mujoco.mjtBias.mjBIAS_AFFINE)
        and int(model.actuator_dyntype[actuator]) in (int(mujoco.mjtDyn.mjDYN_NONE), *filters())
        and bias[0] == 0.0
        and bias[1] < 0.0
        and np.isclose(gain[0], -bias[1], rtol=1e-6, atol=0.0)
    )


def rest_servos(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Let the servos that have a state of their own begin at rest: filters and queues hold the pose of ``data``.

    MuJoCo's reset fills both with zeros in any pose, so that the first steps would jerk the robot.
    """
    if model.na == 0 and not (model.actuator_delay > 0).any():
        return
    on_joint = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    for i in range(model.nu):
        if int(model.actuator_trntype[i]) not in on_joint or not is_position_servo(model, i):
            continue
        place = float(data.qpos[int(model.jnt_qposadr[int(model.actuator_trnid[i, 0])])])
        desired = float(model.actuator_gear[i, 0]) * place
        if model.actuator_ctrllimited[i]:
            desired = float(np.clip(desired, *model.actuator_ctrlrange[i]))
        if int(model.actuator_dyntype[i]) in filters():
            data.act[int(model.actuator_actadr[i])] = desired
        if model.actuator_delay[i] > 0:
            length = int(model.actuator_history[i, 0])
            # The clock need not stand at 0, where MuJoCo's reset puts the queue.
            times = data.time - model.opt.timestep * np.arange(length, 0, -1.0)
            mujoco.mj_initCtrlHistory(model, data, i, times[:, None], np.full((length, 1), desired))
