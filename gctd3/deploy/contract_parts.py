"""The parts of the contract of an exported policy: readings, servos, network, robot and safe command."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from gctd3.tasks.sensors import Source


@dataclass(frozen=True)
class Feature:
    """Describe one feature of a node.

    Attributes:
        reading: Name of the reading that gives its value; ``None`` if it is always 0. With the source ``last action``
            it is the last action of the servo whose joint is the node, 0 at first, which the policy itself knows.
        meaning: Meaning of the reading.
        unit: Unit of the reading and of the three limits; ``1`` for a number without one.
        source: Sensor that gives the reading on a real robot, see :mod:`gctd3.tasks.sensors`.
        low: Smallest reading that is accepted; of a command of the task the smallest that it was trained for.
        high: Largest reading that is accepted, in the same way.
        margin: Part of both limits that lies beyond the range of the joint and of the values seen in simulation.
        binary: Whether the reading is 0 or 1.
        zero: Value of the reading at which the feature is 0: the network sees the difference.
        clock_hz: With the source ``clock``, which the policy itself knows, the feature is ``sin(2 pi (clock_hz t +
            clock_phase))`` at the time ``t`` since the first reading after a reset (Hz).
        clock_phase: Of the same (periods).
        slew_rate: Largest change of a command a second; the policy itself approaches the one that it is given, from the
            one that is nearest to 0 on. 0 for a command that jumps, and for readings.
    """

    reading: str | None
    meaning: str
    unit: str = "1"
    source: Source = "nothing"
    low: float = 0.0
    high: float = 0.0
    margin: float = 0.0
    binary: bool = False
    zero: float = 0.0
    clock_hz: float = 0.0
    clock_phase: float = 0.0
    slew_rate: float = 0.0


@dataclass(frozen=True)
class Node:
    """Describe a node of the robot's graph.

    Attributes:
        name: Name of the node.
        features: Features of the node in one frame, in order.
    """

    name: str
    features: tuple[Feature, ...]


@dataclass(frozen=True)
class Servo:
    """Describe one action: a desired joint angle, and the servo that follows it.

    Attributes:
        actuator: Name of the actuator.
        joint: Name of the joint that it drives.
        angle_reading: Name of the reading of the joint's angle; ``None`` if the policy does not read it.
        low_rad: Smallest desired angle.
        high_rad: Largest desired angle.
        centre_rad: Desired angle at an action of 0.
        scale_rad: Change of the desired angle by an action of 1; it is linear, and stays between the limits.
        start_rad: Angle of the joint at the start of episodes.
        home_rad: Desired angle of the home pose, which holds the joint at ``start_rad`` while the robot stands.
        home_rate_rad_s: Rate of the desired angle on its way to ``home_rad``.
        most_change_rad: Largest change of the desired angle from one control step to the next while the policy acts.
        kp_nm_per_rad: Position gain ``kp``; the torque is ``kp (desired - angle) - kd velocity``.
        kd_nm_s_per_rad: Velocity gain ``kd`` of the same torque.
        effort_nm: Largest torque; ``None`` for no limit.
        time_constant_s: Time constant of a first-order filter between desired angle and servo; 0 for none.
    """

    actuator: str
    joint: str
    angle_reading: str | None
    low_rad: float
    high_rad: float
    centre_rad: float
    scale_rad: float
    start_rad: float
    home_rad: float
    home_rate_rad_s: float
    most_change_rad: float
    kp_nm_per_rad: float
    kd_nm_s_per_rad: float
    effort_nm: float | None
    time_constant_s: float


@dataclass(frozen=True)
class NetworkFile:
    """Describe the exported network.

    Attributes:
        sha256: SHA-256 of the ONNX file; ``None`` for a contract inside the file of its network.
        opset: Version of the ONNX operator set; ``None`` if it is not an ONNX file.
        input: Name of the input, float32 ``[batch, *input_shape]``.
        input_shape: Number of nodes, and of a node's features over all frames.
        output: Name of the output, float32 ``[batch, actions]`` in [-1, 1].
        weights_sha256: SHA-256 of the ``policy.safetensors`` from which it was exported.
    """

    sha256: str | None
    opset: int | None
    input: str
    input_shape: tuple[int, ...]
    output: str
    weights_sha256: str


@dataclass(frozen=True)
class RobotIdentity:
    """Identify the robot of a policy.

    Attributes:
        name: Name of its MJCF file, without the suffix.
        sha256: Its :func:`.robot_hash` when the policy was exported.
        standing_height_m: Height of the root body's origin above the ground when the robot stands, where ``height_m``
            is 0.
    """

    name: str
    sha256: str
    standing_height_m: float


@dataclass(frozen=True)
class Safety:
    """Define the command to the servos in control periods without a good reading, and what stops the policy.

    Attributes:
        hold_periods: Number of such periods for which the last good command is held.
        then: Command after these periods; the servos keep their gains, so that ``kd`` damps.
        after_missed_frames: History after at most ``hold_periods`` missed frames, a late reading's among them; after
            more of them it begins anew with the next frame, as ``history_warm_up`` says.
        tilt_readings: Readings of the body's roll and pitch (rad), or of the component of gravity's direction along the
            body's vertical, -1 for an upright body.
        tilt: Angle between the body's vertical and the world's, computed from them.
        most_tilt_rad: Tilt above which the policy stops until it is reset; ``None`` for none.
    """

    hold_periods: int
    then: Literal["each desired angle goes to home_rad at home_rate_rad_s and stays"]
    after_missed_frames: Literal["repeat the last frame"]
    tilt_readings: tuple[str, ...]
    tilt: Literal["arc cosine of the product of the cosines", "arc cosine of the negative reading"]
    most_tilt_rad: float | None
