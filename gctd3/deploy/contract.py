"""The contract of an exported policy: the readings in its input, and the meaning of its output.

It is written beside the policy as JSON whose keys are the attributes below, with units in their names. Robots read it,
so this module needs the standard library only.
"""

from __future__ import annotations

import dataclasses
import json
import math
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import gctd3
from gctd3.errors import ContractError, RobotError, RunError
from gctd3.files import MANIFEST, OWN_MJCF, OWN_ROBOT, check_file, read_manifest, seal

FORMAT = 3
CHECKSUM = "sha256"  # key of the checksum over the rest of the JSON
ROBOT, ROBOT_HASH = "gctd3.robot", "gctd3.robot_sha256"  # metadata of the ONNX file


@dataclass(frozen=True)
class Feature:
    """Describe one feature of a node.

    Attributes:
        reading: Name of the reading that gives its value; ``None`` if it is always 0.
        meaning: Meaning of the reading.
        binary: Whether its value is 0 or 1.
        zero: Value of the reading at which the feature is 0: the network sees the difference.
    """

    reading: str | None
    meaning: str
    binary: bool = False
    zero: float = 0.0


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
        low_rad: Smallest desired angle.
        high_rad: Largest desired angle.
        centre_rad: Desired angle at an action of 0.
        scale_rad: Change of the desired angle by an action of 1; it is linear, and stays between the limits.
        start_rad: Angle of the joint at the start of episodes.
        most_change_rad: Largest change of the desired angle from one control step to the next.
        kp_nm_per_rad: Position gain ``kp``; the torque is ``kp (desired - angle) - kd velocity``.
        kd_nm_s_per_rad: Velocity gain ``kd`` of the same torque.
        effort_nm: Largest torque; ``None`` for no limit.
        time_constant_s: Time constant of a first-order filter between desired angle and servo; 0 for none.
    """

    actuator: str
    joint: str
    low_rad: float
    high_rad: float
    centre_rad: float
    scale_rad: float
    start_rad: float
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
        sha256: Hash of its physics when the policy was trained, see :func:`robot_hash`.
        standing_height_m: Height of the root body's origin above the ground when the robot stands, where ``height_m``
            is 0.
    """

    name: str
    sha256: str
    standing_height_m: float


@dataclass(frozen=True)
class Contract:
    """Describe the input, the output and the robot of an exported policy, for those who run it.

    Attributes:
        format: Version of the contract's format.
        network: The exported network.
        robot: The robot that it was trained for.
        control_rate_hz: Control steps per second.
        history_frames: Number of frames in the input.
        history_order: Order of a node's features in the input: all features of a frame together, frame after frame.
        history_warm_up: Replacement for frames before the first.
        normalisation: Normalisation of the readings: ``none``, the network takes them as they are.
        nodes: Nodes in the order of the input.
        servos: Servos in the order of the output.
        frames_trained: Number of frames on which the policy was trained.
        trained_with: Versions of the packages that it was trained with.
        exported_with: Versions of the packages that it was exported with.
    """

    format: int
    network: NetworkFile
    robot: RobotIdentity
    control_rate_hz: float
    history_frames: int
    history_order: Literal["oldest first"]
    history_warm_up: Literal["repeat the first frame"]
    normalisation: Literal["none"]
    nodes: tuple[Node, ...]
    servos: tuple[Servo, ...]
    frames_trained: int
    trained_with: dict[str, str]
    exported_with: dict[str, str]

    def __post_init__(self) -> None:
        widths = {len(node.features) * self.history_frames for node in self.nodes}
        shape = (len(self.nodes), *widths)
        names = self.readings
        ordered = all(
            s.low_rad <= angle <= s.high_rad and s.most_change_rad >= 0 and s.scale_rad > 0
            for s in self.servos
            for angle in (s.start_rad, s.centre_rad)
        )
        for right, contradiction in (
            (shape == self.network.input_shape, f"nodes and history_frames make {shape}, not network.input_shape"),
            (len(set(names)) == len(names), "two features have one reading"),
            (self.control_rate_hz > 0 and self.history_frames > 0, "control_rate_hz and history_frames are above 0"),
            (
                bool(self.servos) and ordered,
                "start_rad and centre_rad lie between low_rad and high_rad; scale_rad > 0; most_change_rad >= 0",
            ),
        ):
            if not right:
                raise ContractError(f"The contract contradicts itself: {contradiction}.")

    @property
    def readings(self) -> tuple[str, ...]:
        """Return the names of all readings, in the order of the nodes."""
        return tuple(f.reading for node in self.nodes for f in node.features if f.reading is not None)

    def to_json(self) -> str:
        """Return the contract as JSON, with a checksum of its content."""
        content = json.loads(json.dumps(dataclasses.asdict(self)))
        return json.dumps({**content, CHECKSUM: seal(content)}, indent=2) + "\n"


def read_contract(path: Path) -> Contract:
    """Read the contract in a file.

    Raises:
        ContractError: If the file is missing, damaged or of another format.
    """
    if not path.is_file():
        raise ContractError(f"No contract at {path}: it is exported together with the policy and has to be beside it.")
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ContractError(f"{path} cannot be read: {error}") from error
    try:
        return parse_contract(text)
    except ContractError as error:
        raise ContractError(f"{path}: {error}") from error


def parse_contract(text: str) -> Contract:
    """Parse the JSON that :meth:`Contract.to_json` wrote.

    Raises:
        ContractError: If it is damaged or of another format.
    """
    try:
        content = json.loads(text)
        sealed = content.pop(CHECKSUM)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ContractError(f"no contract of a policy, or damaged: {error!r}.") from error
    if content.get("format") != FORMAT:
        raise ContractError(
            f"it has format {content.get('format')!r}; gctd3 {gctd3.__version__} reads format {FORMAT}."
        )
    if seal(content) != sealed:
        raise ContractError("it is damaged or was edited: its checksum does not fit.")
    contract: Contract = _read(content, Contract, "the contract")
    return contract


def _read(value: Any, hint: Any, where: str) -> Any:  # noqa: ANN401 - JSON to the hinted type
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if dataclasses.is_dataclass(hint) and isinstance(value, Mapping):
        hints = typing.get_type_hints(hint)
        if wrong := sorted(set(hints) ^ set(value)):
            raise ContractError(f"{where} has missing or unknown keys: {', '.join(wrong)}.")
        return typing.cast(Any, hint)(**{key: _read(value[key], hints[key], f"{where}.{key}") for key in hints})
    if origin in (typing.Union, types.UnionType):
        return None if value is None else _read(value, inner[0], where)
    if origin is Literal and value in inner:
        return value
    if origin is tuple and isinstance(value, list):
        return tuple(_read(item, inner[0], f"{where}[{i}]") for i, item in enumerate(value))
    if origin is dict and isinstance(value, dict):
        return {str(key): _read(item, inner[1], f"{where}.{key}") for key, item in value.items()}
    if hint is float and type(value) in (int, float) and math.isfinite(value):
        return float(value)
    if hint in (int, str, bool) and type(value) is hint:
        return value
    expected = hint.__name__ if isinstance(hint, type) else str(hint).removeprefix("typing.")
    raise ContractError(f"{where} must be {expected}, got {value!r}.")


def robot_hash(robot: str | Path) -> str:
    """Compute the hash of a robot's physics, which is the same however its MJCF is spelled.

    Args:
        robot: A run's directory or its copy of the robot (``RUN/robot``), which needs no MuJoCo; or an MJCF or a URDF
            file or the name of a shipped robot, which is completed as ``gctd3.train robot=FILE`` does and compiled.

    Raises:
        ContractError: If it cannot be read, or MuJoCo is needed and is not installed.
    """
    place = Path(robot)
    for folder in (place / OWN_ROBOT, place, place.parent if place.name == OWN_MJCF else place):
        if (folder / MANIFEST).is_file():
            try:
                content = read_manifest(folder)
                for name, kept in content["files"].items():
                    check_file(folder / name, kept)
                return str(content["hash"])
            except (RunError, KeyError, TypeError, AttributeError) as error:
                raise ContractError(f"{folder} cannot be read as a run's copy of its robot: {error}") from error
    try:
        # Late, since a robot need not have MuJoCo.
        physics, settings = (import_module(f"gctd3.robots.{name}") for name in ("physics", "settings"))
        return str(physics.physics_hash(settings.RobotSettings(str(robot)).load().model))
    except ImportError as error:
        raise ContractError(
            f"{robot}: to compare a robot's file needs MuJoCo ({error}); RUN/robot, a run's own copy, needs none."
        ) from error
    except RobotError as error:
        raise ContractError(str(error)) from error
