"""The contract of an exported policy: the readings in its input, and the meaning of its output.

It is written beside the policy as JSON whose keys are the attributes below, with units in their names. Robots read it,
so this module needs the standard library only.
"""

from __future__ import annotations

import dataclasses
import json
import sys
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import gctd3
from gctd3.deploy.contract_checks import CLOCK, COMMAND, LAST_ACTION, contradictions
from gctd3.deploy.contract_parts import Feature, NetworkFile, Node, RobotIdentity, Safety, Servo
from gctd3.errors import ContractError, RobotError, RunError, one_line, shown
from gctd3.files import MANIFEST, OWN_MJCF, OWN_ROBOT, check_file, read_manifest, seal

__all__ = [
    "CHECKSUM",
    "FORMAT",
    "Contract",
    "Feature",
    "NetworkFile",
    "Node",
    "RobotIdentity",
    "Safety",
    "Servo",
    "parse_contract",
    "read_contract",
    "robot_hash",
]
FORMAT = 4
CHECKSUM = "sha256"  # key of the checksum over the rest of the JSON


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
        safety: The command without good readings, and what stops the policy.
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
    safety: Safety
    frames_trained: int
    trained_with: dict[str, str]
    exported_with: dict[str, str]

    def __post_init__(self) -> None:
        for contradiction in contradictions(self):
            raise ContractError(f"The contract contradicts itself: {contradiction}.")

    @property
    def features(self) -> tuple[Feature, ...]:
        """Return the features whose value is given, by a sensor or as a command, in the order of the nodes."""
        given = (f for node in self.nodes for f in node.features if f.reading is not None)
        return tuple(feature for feature in given if feature.source not in (LAST_ACTION, CLOCK))

    @property
    def readings(self) -> tuple[str, ...]:
        """Return the names of the readings that the robot's sensors give, in the order of the nodes."""
        return tuple(str(feature.reading) for feature in self.features if feature.source != COMMAND)

    @property
    def commands(self) -> dict[str, tuple[float, float]]:
        """Return the lowest and the highest command by its name, whose ending is its unit; empty for none."""
        return {str(f.reading): (f.low, f.high) for f in self.features if f.source == COMMAND}

    @property
    def own_actions(self) -> tuple[tuple[int, int, int], ...]:
        """Return node, feature and servo of each feature that is the last action of a servo."""
        servos = {servo.joint: i for i, servo in enumerate(self.servos)}
        return tuple(
            (i, k, servos[node.name])
            for i, node in enumerate(self.nodes)
            for k, feature in enumerate(node.features)
            if feature.source == LAST_ACTION
        )

    @property
    def clocks(self) -> tuple[tuple[int, int, float, float], ...]:
        """Return node, feature, frequency (Hz) and phase (periods) of each feature that is a clock."""
        return tuple(
            (i, k, feature.clock_hz, feature.clock_phase)
            for i, node in enumerate(self.nodes)
            for k, feature in enumerate(node.features)
            if feature.source == CLOCK
        )

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
        actual = seal(content)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ContractError(
            f"no contract of a policy, or damaged: {one_line(error) or type(error).__name__}."
        ) from error
    found = content.get("format")
    if type(found) is int and 0 < found < FORMAT:
        raise ContractError(
            f"it has format {found}, of an older gctd3; gctd3 {gctd3.__version__} reads format {FORMAT}: export the "
            "policy again (python -m gctd3.export run=DIR)."
        )
    if type(found) is not int or found != FORMAT:
        raise ContractError(f"it has format {shown(found)}; gctd3 {gctd3.__version__} reads format {FORMAT}.")
    if actual != sealed:
        raise ContractError("it is damaged or was edited: its checksum does not fit.")
    try:
        contract: Contract = _read(content, Contract, "the contract")
    except RecursionError as error:
        raise ContractError("no contract of a policy, or damaged: it is nested too deeply.") from error
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
    if hint is float and type(value) in (int, float) and abs(value) <= sys.float_info.max:
        return float(value)
    if hint in (int, str, bool) and type(value) is hint:
        return value
    expected = hint.__name__ if isinstance(hint, type) else str(hint).removeprefix("typing.")
    raise ContractError(f"{where} must be {expected}, got {shown(value)}.")


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
