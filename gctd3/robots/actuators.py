"""The walking task's requirements on actuators: position servos, one to a joint."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco

from gctd3.errors import RobotError
from gctd3.robots.mjcf import Joint, joint_name


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
        if model.actuator_biastype[i] != mujoco.mjtBias.mjBIAS_AFFINE or model.actuator_biasprm[i, 1] >= 0:
            raise RobotError(f"{file}: actuator {name!r} must be a <position> servo: actions are desired angles.")
        if not model.actuator_ctrllimited[i]:
            raise RobotError(f"{file}: actuator {name!r} needs a ctrlrange (rad), onto which actions are mapped.")
        if joint in driving:
            raise RobotError(
                f"{file}: actuators {driving[joint]!r} and {name!r} both drive joint {driven!r}: leave one of them."
            )
        driving[joint] = name
