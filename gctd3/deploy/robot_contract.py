"""The contract of a policy, derived from its task and robot: the features of each node, and the commanded servos."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from gctd3.deploy.contract import FORMAT, Contract, Feature, NetworkFile, Node, RobotIdentity, Servo, robot_hash
from gctd3.errors import RobotError
from gctd3.nn.actor import ACTION, NODES
from gctd3.robots.actuators import filters, torque_limit
from gctd3.robots.robot import Robot
from gctd3.tasks.simulated_task import SimulatedTask


def describe(
    task: SimulatedTask,
    most_change: np.ndarray,
    weights: str,
    frames_trained: int,
    trained_with: Mapping[str, str],
    exported_with: Mapping[str, str],
) -> Contract:
    """Build the contract of a policy that is not yet exported.

    Args:
        task: Task on which the policy was trained, with its robot.
        most_change: Largest change of each desired angle in a control step, shape ``[A]`` (rad).
        weights: Checksum of the file of the policy's weights.
        frames_trained: Number of frames on which the policy was trained.
        trained_with: Versions of the packages at training.
        exported_with: Versions of the packages at export.

    Raises:
        RobotError: If an actuator is not a position servo with a gear of 1.
        ContractError: If the robot's file cannot be read.
    """
    nodes, robot, frames = sensed(task), task.robot, task.history
    network = NetworkFile(
        sha256=None,
        opset=None,
        input=NODES,
        input_shape=(len(nodes), task.features * frames),
        output=ACTION,
        weights_sha256=weights,
    )
    return Contract(
        format=FORMAT,
        network=network,
        robot=RobotIdentity(robot.path.stem, robot_hash(robot.path), _standing_height(robot)),
        control_rate_hz=1.0 / task.control_dt,
        history_frames=frames,
        history_order="oldest first",
        history_warm_up="repeat the first frame",
        normalisation="none",
        nodes=nodes,
        servos=tuple(_servo(robot, i, float(most)) for i, most in enumerate(most_change)),
        frames_trained=frames_trained,
        trained_with=dict(trained_with),
        exported_with=dict(exported_with),
    )


def sensed(task: SimulatedTask) -> tuple[Node, ...]:
    """Return the nodes of the robot's graph with the features of :class:`.FeatureTable`."""
    nothing = Feature(None, "nothing: always 0")
    return tuple(
        Node(
            name,
            tuple(
                nothing if r is None else Feature(r.name, r.meaning, r.quantity == "contact", r.zero) for r in readings
            ),
        )
        for name, readings in zip(task.graph.nodes, task.table.readings, strict=True)
    )


def _servo(robot: Robot, index: int, most_change: float) -> Servo:
    model, joint = robot.model, robot.joint(robot.actuated[index])
    gain, bias = float(model.actuator_gainprm[index, 0]), model.actuator_biasprm[index]
    name, dynamics = robot.action_names[index], int(model.actuator_dyntype[index])
    filtered = dynamics in filters()
    plain = dynamics == int(mujoco.mjtDyn.mjDYN_NONE)
    if bias[0] != 0 or bias[1] != -gain or model.actuator_gear[index, 0] != 1 or not (plain or filtered):
        raise RobotError(
            f"{robot.path}: actuator {name!r} must be a <position> servo with a gear of 1 to be exported: a robot is "
            "told desired joint angles."
        )
    effort = torque_limit(robot, index)
    low, high = (float(limit) for limit in robot.action_range[index])
    centre, scale = (float(values[index]) for values in robot.action_map)
    return Servo(
        actuator=name,
        joint=joint.name,
        low_rad=low,
        high_rad=high,
        centre_rad=centre,
        scale_rad=scale,
        start_rad=float(np.clip(robot.start_qpos[joint.qpos], low, high)),
        most_change_rad=most_change,
        kp_nm_per_rad=gain,
        kd_nm_s_per_rad=float(-bias[2]),
        effort_nm=effort if np.isfinite(effort) else None,
        time_constant_s=float(model.actuator_dynprm[index, 0]) if filtered else 0.0,
    )


def _standing_height(robot: Robot) -> float:
    model, data = robot.model, mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    mujoco.mj_kinematics(model, data)
    return float(data.xpos[robot.base.root, 2])
