"""Contradictions within the contract of an exported policy."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

from gctd3.deploy.contract_parts import Feature, Servo

if TYPE_CHECKING:
    from gctd3.deploy.contract import Contract

# A desired angle further from 0 is one in degrees.
MOST_ANGLE = 4.0 * math.pi  # rad
LAST_ACTION, CLOCK = "last action", "clock"  # sources of features that the policy itself knows
COMMAND = "command"  # source of features that an operator or a planner gives
BY_ANGLES, BY_GRAVITY = "arc cosine of the product of the cosines", "arc cosine of the negative reading"
MOST_REPEATS = 10_000  # frames of the history, and periods of holding
LEAST_RATE, MOST_RATE = 1e-3, 1e6  # Hz
# Larger numbers are none of a robot's, and infinite in float32 where they are multiplied.
LARGEST = 1e9


def contradictions(contract: Contract) -> Iterator[str]:
    """Yield a sentence for each contradiction; a later one may presume that there are no earlier ones."""
    yield from _shapes(contract)
    joints = {servo.joint for servo in contract.servos}
    for node in contract.nodes:
        for feature in node.features:
            if feature.source == LAST_ACTION and (node.name not in joints or feature.reading is None):
                yield f"node {node.name!r} has a last action, and no servo drives it"
            if (feature.source == CLOCK) != (0 < feature.clock_hz <= MOST_RATE and abs(feature.clock_phase) <= 1):
                yield f"a feature of node {node.name!r} is a clock without a frequency, or has one and is none"
            if feature.slew_rate < 0 or (feature.slew_rate and feature.source != COMMAND):
                yield f"a feature of node {node.name!r} has a slew rate below 0, or has one and is no command"
            yield from _feature(node.name, feature)
    for servo in contract.servos:
        yield from _servo(servo)
    yield from _safety(contract)


def _shapes(contract: Contract) -> Iterator[str]:
    nodes, servos, given = contract.nodes, contract.servos, [feature.reading for feature in contract.features]
    if not (contract.control_rate_hz > 0 and contract.history_frames > 0):
        yield "control_rate_hz and history_frames are above 0"
    if not (LEAST_RATE <= contract.control_rate_hz <= MOST_RATE and contract.history_frames <= MOST_REPEATS):
        yield (
            f"control_rate_hz is between {LEAST_RATE:g} and {MOST_RATE:g}, history_frames at most {MOST_REPEATS}, got "
            f"{contract.control_rate_hz:g} and {contract.history_frames}"
        )
    shape = (len(nodes), *{len(node.features) * contract.history_frames for node in nodes})
    if shape != contract.network.input_shape:
        yield f"nodes and history_frames make {shape}, not network.input_shape"
    if not contract.readings:
        yield "no feature has a reading"
    if not servos:
        yield "there are no servos"
    for names, what in (
        (map(str, given), "two features have one reading"),
        ((node.name for node in nodes), "two nodes have one name"),
        ((servo.actuator for servo in servos), "two servos have one actuator"),
        ((servo.joint for servo in servos), "two servos have one joint"),
    ):
        if repeated := _repeated(names):
            yield f"{what}, {repeated!r}"


def _repeated(names: Iterable[str]) -> str | None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            return name
        seen.add(name)
    return None


def _feature(node: str, feature: Feature) -> Iterator[str]:
    name = feature.reading
    if name is None:
        return
    # A command that is always the same is one.
    ordered = feature.low <= feature.high if feature.source == COMMAND else feature.low < feature.high
    if not (feature.low >= -LARGEST and ordered and feature.high <= LARGEST):
        yield f"low of {name!r} of node {node!r} is below its high, both within {LARGEST:g}"
    if not abs(feature.zero) <= LARGEST or not feature.margin >= 0:
        yield f"zero of {name!r} is within {LARGEST:g}, and its margin at least 0"
    if feature.binary and (feature.low, feature.high, feature.zero) != (0.0, 1.0, 0.0):
        yield f"{name!r} is binary, so that its low is 0, its high 1 and its zero 0"


def _servo(servo: Servo) -> Iterator[str]:
    low, high, name = servo.low_rad, servo.high_rad, servo.actuator
    if not -MOST_ANGLE <= low < high <= MOST_ANGLE:
        yield f"low_rad of {name!r} is below its high_rad, both within 4 pi rad"
    for key in ("start_rad", "centre_rad", "home_rad"):
        if not low <= getattr(servo, key) <= high:
            yield (
                f"start_rad, centre_rad and home_rad lie between low_rad and high_rad; {key} of {name!r} is "
                f"{getattr(servo, key):g}, the limits {low:g} and {high:g}"
            )
    if not 0 < servo.scale_rad <= 2.0 * (high - low):
        yield (
            f"scale_rad of {name!r} is above 0 and at most twice the way from low_rad to high_rad, got "
            f"{servo.scale_rad:g} rad on a way of {high - low:g} rad"
        )
    if not (0 <= servo.most_change_rad <= LARGEST and 0 < servo.home_rate_rad_s <= LARGEST):
        yield f"most_change_rad of {name!r} is at least 0, home_rate_rad_s above 0"
    for key in ("kp_nm_per_rad", "kd_nm_s_per_rad", "effort_nm", "time_constant_s"):
        if (getattr(servo, key) or 0.0) < 0:
            yield f"{key} of {name!r} is at least 0"


def _safety(contract: Contract) -> Iterator[str]:
    safety, readings = contract.safety, set(contract.readings)
    if not 0 <= safety.hold_periods <= MOST_REPEATS:
        yield f"safety.hold_periods is at least 0 and at most {MOST_REPEATS}"
    if safety.most_tilt_rad is not None and not (0 < safety.most_tilt_rad < math.pi and safety.tilt_readings):
        yield "safety.most_tilt_rad is between 0 and pi, and has tilt_readings"
    if safety.tilt == BY_GRAVITY and len(safety.tilt_readings) > 1:
        yield "safety.tilt needs one of tilt_readings"
    angles = [servo.angle_reading for servo in contract.servos if servo.angle_reading is not None]
    for name in (*safety.tilt_readings, *angles):
        if name not in readings:
            yield f"{name!r} is none of the readings"
    if repeated := _repeated(angles):
        yield f"two servos have one angle_reading, {repeated!r}"
