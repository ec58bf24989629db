"""Topics of a policy: which readings and commands of its contract each message carries. Light."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from gctd3.bridge.inertial import inertial_readings, unpack_inertial
from gctd3.bridge.messages import ImuSample, JointSample, MessageError, Topic
from gctd3.bridge.settings import Names
from gctd3.deploy.contract import Contract
from gctd3.errors import ConfigError

CLOCK = Topic("/clock", "clock")
CMD_VEL = Topic("/cmd_vel", "twist")
IMU = Topic("/imu/data", "imu")
ENDED = Topic("/walk_ended", "text", latched=True)  # the simulator's last word
# Commands by the fields of a velocity on /cmd_vel; the names are those of the contract.
VELOCITY_COMMANDS = {"command_forward_m_s": "forward", "command_side_m_s": "side", "command_turn_rad_s": "turn"}
DISTANCE = "distance_m"  # what a simulator knows beside the contract's readings


@dataclass(frozen=True)
class JointRow:
    """Place readings in a joint's entry of a JointState.

    Attributes:
        name: Name of the joint in the message.
        position: Name of the reading of its position; ``None`` for none, which is sent as 0.
        velocity: Name of the reading of its velocity; ``None`` for none.
        sign: Factor of both: the message holds ``offset + sign * reading``.
        offset: Position at a reading of 0 (rad or m).
    """

    name: str
    position: str | None
    velocity: str | None
    sign: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Layout:
    """Hold the topics of a policy and what they carry.

    Attributes:
        joints: Topic of the joints' states, which a simulator publishes last in each control step.
        rows: Joints in it, in order.
        single: Topic of each reading that has one of its own, by the reading's name.
        inertial: Readings in the message on ``/imu/data``; without any there is no such topic.
        command: Topic of all desired angles together; ``None`` where each actuator has one.
        actuators: Name of each joint in that message by its actuator, or the actuator's own topic.
        simulator: Name of the simulator's node.
        policy: Name of the policy's node.
        services: Names of the services that reset, pause and resume the simulation.
    """

    joints: Topic
    rows: tuple[JointRow, ...]
    single: dict[str, Topic]
    command: Topic | None
    actuators: dict[str, str]
    simulator: str = "simulator"
    policy: str = "policy"
    services: tuple[str, str, str] = ("/reset", "/pause", "/unpause")
    inertial: tuple[str, ...] = ()

    @property
    def sensors(self) -> tuple[Topic, ...]:
        """Return the topics of the readings, that of the joints last."""
        return (*self.single.values(), *([IMU] if self.inertial else []), self.joints)

    @property
    def commands(self) -> tuple[Topic, ...]:
        """Return the topics of the desired angles."""
        return (self.command,) if self.command else tuple(Topic(name, "number") for name in self.actuators.values())

    def pack_readings(
        self, stamp: int, frame: str, readings: Mapping[str, float], imu: ImuSample | None = None
    ) -> list[tuple[Topic, Any]]:
        """Return the messages of a control step, in the order of :attr:`sensors`.

        Args:
            stamp: Time of the readings (ns).
            frame: ``frame_id`` of the joints' message.
            readings: Value of each reading, and of ``distance_m``.
            imu: What the inertial unit measures, where there are readings in :attr:`inertial`.
        """
        messages: list[tuple[Topic, Any]] = []
        for name, topic in self.single.items():
            messages.append((topic, float(readings[name]) if topic.kind == "number" else bool(readings[name])))
        if self.inertial:
            messages.append((IMU, imu))

        def number(name: str | None, sign: float, offset: float) -> float:
            # Exact where there is nothing to convert.
            value = 0.0 if name is None else float(readings[name])
            return value if (sign, offset) == (1.0, 0.0) else offset + sign * value

        names = tuple(row.name for row in self.rows)
        positions = tuple(number(row.position, row.sign, row.offset) for row in self.rows)
        velocities = tuple(number(row.velocity, row.sign, 0.0) for row in self.rows)
        return [*messages, (self.joints, JointSample(stamp, frame, names, positions, velocities))]

    def unpack_reading(self, topic: Topic, message: Any) -> dict[str, float]:  # noqa: ANN401
        """Return the readings in a message, by name.

        Raises:
            MessageError: If the joints' message lacks a joint, or its lists differ in length, or that of the inertial
                unit lacks what the policy reads.
        """
        if topic == IMU:
            return unpack_inertial(topic, message, self.inertial)
        if topic != self.joints:
            return {name: float(message) for name, own in self.single.items() if own == topic}
        places = _places(topic, message, [row.name for row in self.rows])
        if any(row.velocity for row in self.rows) and len(message.velocities) != len(message.names):
            raise MessageError(
                f"{topic.name} has {len(message.names)} names and {len(message.velocities)} velocities, expected as "
                "many of both."
            )
        found = {}
        for row in self.rows:
            place = places[row.name]
            if row.position is not None and row.position != DISTANCE:
                found[row.position] = (message.positions[place] - row.offset) * row.sign
            if row.velocity is not None:
                found[row.velocity] = message.velocities[place] * row.sign
        return found

    def pack_command(self, stamp: int, frame: str, angles: Mapping[str, float]) -> list[tuple[Topic, Any]]:
        """Return the messages of desired angles.

        Args:
            stamp: Time of the readings from which they were computed (ns).
            frame: ``frame_id`` of those readings.
            angles: Desired angle of each actuator (rad).
        """
        if self.command is None:
            return [(Topic(name, "number"), angles[actuator]) for actuator, name in self.actuators.items()]
        names, values = tuple(self.actuators.values()), tuple(angles[actuator] for actuator in self.actuators)
        return [(self.command, JointSample(stamp, frame, names, values))]

    def unpack_command(self, topic: Topic, message: Any) -> dict[str, float]:  # noqa: ANN401
        """Return the desired angles in a message by the name of the actuator (rad).

        Raises:
            MessageError: If a joint is missing, or the lists differ in length.
        """
        if self.command is None:
            return {actuator: float(message) for actuator, name in self.actuators.items() if name == topic.name}
        places = _places(topic, message, list(self.actuators.values()))
        return {actuator: message.positions[places[name]] for actuator, name in self.actuators.items()}

    def table(self, commanded: bool) -> list[tuple[str, str, str]]:
        """Return name, direction and type of each topic, for people.

        Args:
            commanded: Whether the policy follows commanded velocities.
        """
        from gctd3.bridge.messages import TYPES

        rows = [(topic.name, "simulator to policy", TYPES[topic.kind]) for topic in (*self.sensors, CLOCK, ENDED)]
        rows += [(topic.name, "policy to simulator", TYPES[topic.kind]) for topic in self.commands]
        return rows + ([(CMD_VEL.name, "operator to policy", TYPES[CMD_VEL.kind])] if commanded else [])


def _places(topic: Topic, message: JointSample, expected: list[str]) -> dict[str, int]:
    """Return the place of each name in a message, if it holds the expected joints and a position for each."""
    if len(message.positions) != len(message.names):
        raise MessageError(
            f"{topic.name} has {len(message.names)} names and {len(message.positions)} positions, expected as many of "
            "both."
        )
    places = {name: place for place, name in enumerate(message.names)}
    if missing := [name for name in expected if name not in places]:
        raise MessageError(
            f"{topic.name} has {len(message.names)} joints, expected {len(expected)}; missing {', '.join(missing)}."
        )
    return places


def layout_of(contract: Contract, names: Names) -> Layout:
    """Return the topics of a policy.

    Args:
        contract: Contract of the policy.
        names: Which names they have, see :class:`.RosSettings`.

    Raises:
        ConfigError: If the names of two topics would be the same, or the paper's do not fit the robot.
    """
    return _of_contract(contract) if names == "contract" else _of_biped(contract, names)


def topic_name(name: str) -> str:
    """Return a name as ROS 1 and ROS 2 accept it: letters, digits and underscores, a letter first."""
    plain = re.sub(r"_{2,}", "_", re.sub(r"\W", "_", name, flags=re.ASCII)).strip("_") or "x"
    return f"/{plain}" if plain[0].isalpha() else f"/x_{plain}"


def _of_contract(contract: Contract) -> Layout:
    taken: set[str] = set()
    rows = []
    for node in contract.nodes:
        readings = {str(feature.reading) for feature in node.features if feature.reading is not None}
        angle, velocity = f"angle_{node.name}_rad", f"velocity_{node.name}_rad_s"
        if {angle, velocity} & readings:
            taken |= {angle, velocity}
            has = (angle if angle in readings else None, velocity if velocity in readings else None)
            rows.append(JointRow(node.name, *has))
    inertial = inertial_readings(contract)
    taken |= set(inertial)
    binary = {str(feature.reading) for feature in contract.features if feature.binary}
    single = {
        name: Topic(topic_name(name), "switch" if name in binary else "number")
        for name in contract.readings
        if name not in taken
    }
    joints, command = Topic("/joint_states", "joints"), Topic("/joint_command", "joints")
    _check_different([*(topic.name for topic in single.values()), joints.name, command.name, CLOCK.name, ENDED.name])
    actuators = {servo.actuator: servo.joint for servo in contract.servos}
    return Layout(joints, tuple(rows), single, command, actuators, inertial=inertial)


def _check_different(names: Iterable[str]) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise ConfigError(f"names=contract: two readings would be published as {name}; rename one of them.")
        seen.add(name)


# The biped's joints in the authors' words. The root's height counts downwards from where the robot is spawned, 0.0235 m
# above standing (models/biped/README.md).
_AUTHORS = {
    "ankle_left": "shankL_footL",
    "ankle_right": "shankR_footR",
    "knee_left": "thighL_shankL",
    "knee_right": "thighR_shankR",
    "hip_left": "waist_thighL",
    "hip_right": "waist_thighR",
}
_SPAWN = 0.0235  # m


def _of_biped(contract: Contract, names: Names) -> Layout:
    feet = {"down_foot_right": "R", "down_foot_left": "L"}
    wanted = {"height_m", "velocity_m_s", *feet}
    wanted |= {text for joint in _AUTHORS for text in (f"angle_{joint}_rad", f"velocity_{joint}_rad_s")}
    if set(contract.readings) != wanted or {servo.actuator for servo in contract.servos} != set(_AUTHORS):
        raise ConfigError(f"names={names} are the biped's; this policy is for {contract.robot.name!r}: names=contract.")
    rows = [
        JointRow("boom_waist", "height_m", None, -1.0, _SPAWN),
        JointRow("outer_inner", DISTANCE, "velocity_m_s"),
        *(JointRow(name, f"angle_{joint}_rad", f"velocity_{joint}_rad_s") for joint, name in _AUTHORS.items()),
    ]
    authors = names == "authors"
    contact = "/foot{}_contact_sensor_state" if authors else "/Foot{}_contact"
    single = {name: Topic(contact.format(side), "contacts" if authors else "switch") for name, side in feet.items()}
    return Layout(
        Topic("/joint_states" if authors else "/Joint_states", "joints"),
        tuple(rows),
        single,
        None,
        {s.actuator: f"/{_AUTHORS[s.joint]}_position_controller/command" for s in contract.servos},
        "gazebo",
        "walker_control_script" if authors else "walker_controller",
        ("/gazebo/reset_world", "/gazebo/pause_physics", "/gazebo/unpause_physics"),
    )
