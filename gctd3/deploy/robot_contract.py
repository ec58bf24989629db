"""The contract of a policy, derived from its task and robot: the features of each node, and the commanded servos."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from gctd3.deploy.contract import FORMAT, Contract
from gctd3.deploy.contract_checks import CLOCK, COMMAND
from gctd3.deploy.contract_parts import Feature, NetworkFile, Node, RobotIdentity, Safety, Servo
from gctd3.deploy.settings import ExportSettings
from gctd3.errors import ConfigError, RobotError, suggest
from gctd3.nn.actor import ACTION, NODES
from gctd3.robots.actuators import filters, torque_limit
from gctd3.robots.physics import physics_hash
from gctd3.robots.robot import Robot
from gctd3.tasks.features import Reading
from gctd3.tasks.sensors import EXACT, SOURCES, Source
from gctd3.tasks.simulated_task import SimulatedTask
from gctd3.tasks.terminations import Fall

# Units by the last part of a reading's name; the longer endings first.
UNITS = {"_rad_s": "rad/s", "_m_s": "m/s", "_rad": "rad", "_m": "m"}
GRAVITY_UP = "gravity_up"  # reading of gravity's direction along the body's vertical, -1 for an upright body
# Limits of a reading: the range of the values seen in simulation, and as much again on each side; of a joint's angle
# the range of the joint and a quarter of it on each side. Sensors that work never reach them, pushes included.
ANGLE_MARGIN = 0.25
# Sources of quantities that have but one.
BY_QUANTITY: dict[str, Source] = {"command": "command", "action": "last action", "direction": "IMU orientation"}
# What counts for a range that is smaller, in the unit of the quantity.
LEAST_RANGE = {"angle": 0.4, "angular velocity": 1.0, "length": 0.1, "velocity": 0.5}


@dataclass(frozen=True)
class Rehearsed:
    """Hold what a policy does in simulation.

    Attributes:
        nodes: Features of the nodes in one frame in the states that it visits, shape ``[T, N, F]``.
        most_change: Largest change of each desired angle in a control step, with a margin, shape ``[A]`` (rad).
    """

    nodes: np.ndarray
    most_change: np.ndarray


def describe(
    task: SimulatedTask,
    rehearsed: Rehearsed,
    weights: str,
    frames_trained: int,
    trained_with: Mapping[str, str],
    exported_with: Mapping[str, str],
    hold: float = ExportSettings.hold,
    home_rate: float = ExportSettings.home_rate,
) -> Contract:
    """Build the contract of a policy that is not yet exported.

    Args:
        task: Task on which the policy was trained, with its robot.
        rehearsed: What the policy does in simulation.
        weights: Checksum of the file of the policy's weights.
        frames_trained: Number of frames on which the policy was trained.
        trained_with: Versions of the packages at training.
        exported_with: Versions of the packages at export.
        hold: Time for which the last command is held without good readings (s).
        home_rate: Rate of each joint to the home pose (rad/s).

    Raises:
        RobotError: If an actuator is not a position servo with a gear of 1.
        ConfigError: If a reading names an unknown source.
    """
    nodes, robot, frames = sensed(task, rehearsed.nodes), task.robot, task.history
    readings = {feature.reading for node in nodes for feature in node.features}
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
        robot=RobotIdentity(robot.path.stem, physics_hash(robot.model), _standing_height(robot)),
        control_rate_hz=1.0 / task.control_dt,
        history_frames=frames,
        history_order="oldest first",
        history_warm_up="repeat the first frame",
        normalisation="none",
        nodes=nodes,
        servos=tuple(
            _servo(robot, i, float(most), home_rate, readings) for i, most in enumerate(rehearsed.most_change)
        ),
        safety=_safety(task, readings, hold),
        frames_trained=frames_trained,
        trained_with=dict(trained_with),
        exported_with=dict(exported_with),
    )


def sensed(task: SimulatedTask, visited: np.ndarray) -> tuple[Node, ...]:
    """Return the nodes of the robot's graph with the features of :class:`.FeatureTable`.

    Args:
        task: The task.
        visited: Features of the nodes in states of the simulation, shape ``[T, N, F]``.

    Raises:
        ConfigError: If a reading names an unknown source.
    """
    least, most = visited.min(axis=0), visited.max(axis=0)
    return tuple(
        Node(
            name,
            tuple(
                Feature(None, "nothing: always 0")
                if reading is None
                else _feature(task, name, reading, visited[:, i, k], float(least[i, k]), float(most[i, k]))
                for k, reading in enumerate(readings)
            ),
        )
        for i, (name, readings) in enumerate(zip(task.graph.nodes, task.table.readings, strict=True))
    )


def _feature(
    task: SimulatedTask, node: str, reading: Reading, values: np.ndarray, least: float, most: float
) -> Feature:
    if reading.source not in SOURCES:
        raise ConfigError(
            f"The reading {reading.name!r} has the unknown source {reading.source!r}."
            f"{suggest(reading.source, SOURCES)} Sources: {', '.join(SOURCES)}."
        )
    source = reading.source if reading.source != "not stated" else BY_QUANTITY.get(reading.quantity, "not stated")
    if source == CLOCK:
        return Feature(
            reading.name, reading.meaning, "1", source, -1.0, 1.0, clock_hz=reading.frequency, clock_phase=reading.phase
        )
    unit = next((unit for ending, unit in UNITS.items() if reading.name.endswith(ending)), "1")
    # A count of contacts is more than 0 or 1.
    binary = reading.quantity == "contact" and bool(np.isin(values, (0.0, 1.0)).all())
    if binary:
        return Feature(reading.name, reading.meaning, unit, source, 0.0, 1.0, 0.0, True)
    commands = task.command_ranges()
    if source == COMMAND and reading.name in commands:
        slew = task.command_slew_rates().get(reading.name, 0.0)
        return Feature(
            reading.name, reading.meaning, unit, source, *commands[reading.name], zero=reading.zero, slew_rate=slew
        )
    low, high, margin = _limits(task.robot, node, reading, least + reading.zero, most + reading.zero)
    return Feature(reading.name, reading.meaning, unit, source, low, high, margin, False, reading.zero)


def _limits(robot: Robot, node: str, reading: Reading, least: float, most: float) -> tuple[float, float, float]:
    """Return the smallest and the largest reading that are accepted, and the margin in both."""
    joint = next((joint for joint in robot.joints if joint.name == node), None)
    if reading.quantity == "angle" and joint is None:
        return -np.pi, np.pi, 0.0
    if reading.quantity == "angle" and joint is not None:
        if robot.model.jnt_limited[joint.id]:
            least, most = min(least, robot.model.jnt_range[joint.id, 0]), max(most, robot.model.jnt_range[joint.id, 1])
        margin = ANGLE_MARGIN * max(most - least, LEAST_RANGE["angle"])
    else:
        margin = max(most - least, LEAST_RANGE.get(reading.quantity, 1.0))
    return float(least - margin), float(most + margin), float(margin)


def _safety(task: SimulatedTask, readings: Collection[str | None], hold: float) -> Safety:
    """Return the safe command: the tilt that stops is the smallest at which the task ends an episode."""
    tilts = [term.tilt for term in task.terminations.values() if isinstance(term, Fall) and term.tilt is not None]
    names = tuple(name for name in ("roll_rad", "pitch_rad") if name in readings)
    by_gravity = not names and GRAVITY_UP in readings
    names = (GRAVITY_UP,) if by_gravity else names
    return Safety(
        hold_periods=round(hold / task.control_dt),
        then="each desired angle goes to home_rad at home_rate_rad_s and stays",
        after_missed_frames="repeat the last frame",
        tilt_readings=names,
        tilt="arc cosine of the negative reading" if by_gravity else "arc cosine of the product of the cosines",
        most_tilt_rad=min(tilts, default=None) if names else None,
    )


def _servo(robot: Robot, index: int, most_change: float, home_rate: float, readings: Collection[str | None]) -> Servo:
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
    start = float(np.clip(robot.start_qpos[joint.qpos], low, high))
    home = start if robot.standing_command is None else float(np.clip(robot.standing_command[index], low, high))
    angle = f"angle_{joint.name}_rad"
    return Servo(
        actuator=name,
        joint=joint.name,
        angle_reading=angle if angle in readings else None,
        low_rad=low,
        high_rad=high,
        centre_rad=centre,
        scale_rad=scale,
        start_rad=start,
        home_rad=home,
        home_rate_rad_s=home_rate,
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


def warnings_of(contract: Contract, robot: Robot) -> list[str]:
    """Return a line for each thing that the robot's software has to do about a contract.

    Args:
        contract: The contract.
        robot: Its robot.
    """
    by_source = {source: [f.reading for f in contract.features if f.source == source] for source in SOURCES}
    lines = []
    if exact := [f"{name} ({source})" for source in EXACT for name in by_source[source]]:
        lines.append(
            f"No robot that walks freely measures these readings, only what is in brackets: {', '.join(exact)}. "
            "Estimate them, or train without them (task.features)."
        )
    if unknown := by_source["not stated"]:
        lines.append(f"The sensors of these readings are not stated (Reading.source): {', '.join(map(str, unknown))}.")
    loose = [
        servo.joint
        for servo in contract.servos
        if servo.kd_nm_s_per_rad == 0 and robot.model.dof_damping[robot.joint(servo.joint).qvel] == 0
    ]
    if loose:
        lines.append(f"Nothing damps these joints in the safe command (kd is 0): {', '.join(loose)}.")
    if contract.safety.most_tilt_rad is None and robot.base.free is not None:
        lines.append("No tilt stops this policy: it reads no orientation, or its task ends at none.")
    return lines
