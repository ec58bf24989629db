"""An exported policy as one C++17 header without dependencies: network, contract, history, limits and safe command."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.resources import files

import gctd3
from gctd3.deploy.contract import Contract
from gctd3.deploy.contract_checks import BY_GRAVITY
from gctd3.deploy.cpp_network import to_cpp_network

NAMESPACE = "gctd3_policy"
TEMPLATE = "policy_template.hpp"
CHUNK = 8_000  # characters of a text in C++: compilers need not take more than 65,536 in one


def to_cpp(content: bytes, contract: Contract) -> str:
    """Return the C++ header of an ONNX file and its contract.

    Raises:
        ContractError: If the network has an operator that is not translated.
    """
    network = to_cpp_network(content)
    parts = {
        "ROBOT": " ".join(contract.robot.name.split()),
        "VERSION": gctd3.__version__,
        "NAMESPACE": NAMESPACE,
        "PERIOD": f"{1.0 / contract.control_rate_hz:g}",
        "CONTRACT": _contract(contract),
        "CONSTANTS": "\n".join(network.constants),
        "STATEMENTS": "\n".join(f"  {statement}" for statement in network.statements),
        "SCRATCH": str(max(network.scratch, 1)),
    }
    text = files("gctd3.deploy").joinpath(TEMPLATE).read_text(encoding="utf-8")
    # What is filled in is not looked through again: a robot's name may be anything.
    for i, name in enumerate(parts):
        text = text.replace(f"@{name}@", f"\0{i}\0")
    for i, part in enumerate(parts.values()):
        text = text.replace(f"\0{i}\0", part)
    return text


def _contract(contract: Contract) -> str:
    nodes, servos, safety, features = contract.nodes, contract.servos, contract.safety, contract.features
    width = len(nodes[0].features)
    names = [str(feature.reading) for feature in features]
    place = {name: i for i, name in enumerate(names)}
    placed = [i * width + k for i, n in enumerate(nodes) for k, f in enumerate(n.features) if f.reading in place]
    own = contract.own_actions
    clocks = contract.clocks
    angles = [place.get(str(servo.angle_reading), 0) for servo in servos]
    tilts = [place[name] for name in safety.tilt_readings]
    lines = [
        f"constexpr int NODES = {len(nodes)}, FEATURES = {width}, FRAMES = {contract.history_frames};",
        f"constexpr int READINGS = {len(features)}, SERVOS = {len(servos)}, TILTS = {len(tilts)};",
        f"constexpr int HOLD = {safety.hold_periods};  // control periods",
        f"constexpr double PERIOD = {1.0 / contract.control_rate_hz!r};  // s",
        f"constexpr double MOST_TILT = {safety.most_tilt_rad or 0.0!r};  // rad, 0 for none",
        f"constexpr bool CAN_START = {_bool(all(servo.angle_reading is not None for servo in servos))};",
        _array("const char*", "READING_NAMES", map(_text, names)),
        _array("const char*", "READING_UNITS", (_text(f.unit) for f in features)),
        _array("double", "LEAST", (repr(f.low) for f in features)),
        _array("double", "MOST", (repr(f.high) for f in features)),
        _array("double", "ZERO", (repr(f.zero) for f in features)),
        _array("double", "SLEW", (repr(f.slew_rate / contract.control_rate_hz) for f in features)),
        _array("bool", "BINARY", (_bool(f.binary) for f in features)),
        _array("int", "PLACE", map(str, placed)),
        # An array of no numbers is not allowed.
        _array("int", "TILT", map(str, tilts or [0])),
        f"constexpr bool BY_GRAVITY = {_bool(safety.tilt == BY_GRAVITY)};",
        f"constexpr int OWN = {len(own)};  // features that are a servo's last action",
        _array("int", "OWN_PLACE", [str(i * width + k) for i, k, _ in own] or ["0"]),
        _array("int", "OWN_SERVO", [str(servo) for _, _, servo in own] or ["0"]),
        f"constexpr int CLOCKS = {len(clocks)};  // features that are a clock",
        _array("int", "CLOCK_PLACE", [str(i * width + k) for i, k, _, _ in clocks] or ["0"]),
        _array("double", "CLOCK_HZ", [repr(hz) for _, _, hz, _ in clocks] or ["0.0"]),
        _array("double", "CLOCK_PHASE", [repr(phase) for *_, phase in clocks] or ["0.0"]),
        _array("const char*", "SERVO_NAMES", (_text(servo.actuator) for servo in servos)),
        _array("int", "ANGLE", map(str, angles)),
        *(
            _array("double", name, (repr(getattr(servo, key)) for servo in servos))
            for name, key in (
                ("LOW", "low_rad"),
                ("HIGH", "high_rad"),
                ("CENTRE", "centre_rad"),
                ("SCALE", "scale_rad"),
                ("HOME", "home_rad"),
                ("MOST_CHANGE", "most_change_rad"),
                ("KP", "kp_nm_per_rad"),
                ("KD", "kd_nm_s_per_rad"),
            )
        ),
        _array("double", "HOME_STEP", (repr(servo.home_rate_rad_s / contract.control_rate_hz) for servo in servos)),
    ]
    text = contract.to_json()
    chunks = [text[i : i + CHUNK] for i in range(0, len(text), CHUNK)]
    # The keys in JSON, as policy.json beside an .onnx file has them.
    return "\n".join([*lines, "constexpr const char* CONTRACT =", *map(_text, chunks)]) + ";"


def _array(kind: str, name: str, items: Iterable[str]) -> str:
    texts = list(items)
    return f"constexpr {kind} {name}[{len(texts)}] = {{{', '.join(texts)}}};"


def _bool(value: bool) -> str:
    return "true" if value else "false"


def _text(text: str) -> str:
    """Return a C++ string: UTF-8 bytes, other than printable ASCII in octal, which ends after three digits."""
    return (
        '"'
        + "".join(
            chr(byte) if 32 <= byte < 127 and chr(byte) not in '"\\?' else f"\\{byte:03o}" for byte in text.encode()
        )
        + '"'
    )
