"""The network of an exported policy: opened with onnxruntime, and compared with its contract before it is used."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from gctd3.deploy.contract import Contract
from gctd3.errors import ContractError, one_line, shown
from gctd3.files import checksum

# Metadata of the ONNX file: the robot, and what its input and its output are, so that an edited contract is found.
ROBOT, ROBOT_HASH = "gctd3.robot", "gctd3.robot_sha256"
READINGS, ACTUATORS = "gctd3.readings", "gctd3.actuators"
FLOAT32 = "tensor(float)"
# Fields of the protocol buffers ModelProto and OperatorSetIdProto of onnx.proto, and the two wire types in use there.
_OPSETS, _DOMAIN, _VERSION = 8, 1, 2
_VARINT, _BYTES = 0, 2


def metadata(contract: Contract) -> dict[str, str]:
    """Return what the ONNX file of a contract says about itself."""
    return {
        ROBOT: contract.robot.name,
        ROBOT_HASH: contract.robot.sha256,
        READINGS: json.dumps([[node.name, [f.reading for f in node.features]] for node in contract.nodes]),
        ACTUATORS: json.dumps([servo.actuator for servo in contract.servos]),
    }


def open_session(model: Path | bytes) -> Any:  # noqa: ANN401 - onnxruntime is untyped
    """Create an ``onnxruntime.InferenceSession`` on one CPU thread.

    Raises:
        ContractError: If the model cannot be read.
        ImportError: If onnxruntime is not installed.
    """
    try:
        onnxruntime = import_module("onnxruntime")
    except ImportError as error:
        raise ImportError("To run an exported policy needs onnxruntime: pip install 'gctd3[deploy]'.") from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3  # errors
    source = model if isinstance(model, bytes) else str(model)
    try:
        return onnxruntime.InferenceSession(source, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's errors share no base class
        what = "The model" if isinstance(model, bytes) else model
        raise ContractError(f"{what} is no ONNX file that onnxruntime can run: {one_line(error)}.") from error


def open_network(file: Path, contract: Contract) -> Any:  # noqa: ANN401
    """Open the network of a contract, and run it once.

    Raises:
        ContractError: If the file does not belong to the contract, or input, output, operator set or metadata are not
            those of the contract.
    """
    session = open_session(file)
    beside, said = file.with_suffix(".json"), session.get_modelmeta().custom_metadata_map
    if said.get(ROBOT_HASH, contract.robot.sha256) != contract.robot.sha256:
        raise ContractError(
            f"{file} is of another robot than its contract: of {said.get(ROBOT)!r}, the contract of "
            f"{contract.robot.name!r} ({beside})."
        )
    if checksum(file) != contract.network.sha256:
        raise ContractError(
            f"{file} and {beside} do not belong together: the checksum in the contract is of another file. Export both "
            "again, or copy both."
        )
    for difference in _differences(session, said, file, contract):
        raise ContractError(f"{file} is not the network that {beside} describes: {difference}.")
    return session


def _differences(session: Any, said: Mapping[str, str], file: Path, contract: Contract) -> Iterator[str]:  # noqa: ANN401
    network = contract.network
    for what, ports, name, shape in (
        ("input", session.get_inputs(), network.input, network.input_shape),
        ("output", session.get_outputs(), network.output, (len(contract.servos),)),
    ):
        found = [port.name for port in ports]
        if found != [name]:
            yield f"the contract's only {what} is {name!r}, the file's are {', '.join(map(repr, found))}"
        (port,) = ports
        if port.type != FLOAT32:
            yield f"{what} {name!r} is float32 in the contract, {port.type} in the file"
        batch, *rest = port.shape or [None]
        # A named dimension, or one without a size, takes any number of states.
        if isinstance(batch, int) or tuple(rest) != tuple(shape):
            yield f"{what} {name!r} is of shape {['batch', *shape]} in the contract, {list(port.shape)} in the file"
    opset = read_opset(file.read_bytes())
    if opset != network.opset:
        yield f"the operator set is {network.opset} in the contract, {opset} in the file"
    for key, expected in metadata(contract).items():
        if said.get(key) != expected:
            yield f"{key.partition('.')[2]}: {_first_difference(expected, said.get(key))}"
    try:
        (action,) = session.run([network.output], {network.input: np.zeros((2, *network.input_shape), np.float32)})
    except Exception as error:  # onnxruntime's errors share no base class
        yield f"it does not run: {one_line(error)}"
    else:
        if action.shape != (2, len(contract.servos)) or not np.isfinite(action).all():
            yield f"of two states of zeros it makes {action.shape} numbers, or some that are not finite"


def _first_difference(expected: str, found: str | None) -> str:
    """Describe the first difference of two texts, entry by entry if both are lists in JSON."""
    if found is None:
        return "the file does not say them"
    try:
        pairs = list(zip(json.loads(expected), json.loads(found), strict=True))
    except (ValueError, TypeError, RecursionError):
        return f"{shown(expected)} in the contract, {shown(found)} in the file"
    for place, (one, other) in enumerate(pairs, 1):
        if one != other:
            return f"number {place} is {shown(one)} in the contract, {shown(other)} in the file"
    return "written in another way in the file"


def read_opset(model: bytes) -> int | None:
    """Return the version of ONNX's own operator set in a serialised ``ModelProto``; ``None`` if it names none.

    Source: https://github.com/onnx/onnx/blob/main/onnx/onnx.proto and
    https://protobuf.dev/programming-guides/encoding. onnxruntime does not tell.
    """
    for field, content in _fields(model):
        if field == _OPSETS and isinstance(content, bytes):
            entry = dict(_fields(content))
            version = entry.get(_VERSION)
            if entry.get(_DOMAIN, b"") in (b"", b"ai.onnx") and isinstance(version, int):
                return version
    return None


def _fields(message: bytes) -> Iterator[tuple[int, int | bytes]]:
    """Yield number and content of each field of a protocol buffer; an unknown wire type ends it."""
    place = 0
    while place < len(message):
        key, place = _varint(message, place)
        value: int | bytes
        if key & 7 == _VARINT:
            value, place = _varint(message, place)
        elif key & 7 == _BYTES:
            length, place = _varint(message, place)
            value, place = message[place : place + length], place + length
        else:
            return
        yield key >> 3, value


def _varint(message: bytes, place: int) -> tuple[int, int]:
    value = shift = 0
    while place < len(message):
        byte = message[place]
        value, place, shift = value | (byte & 0x7F) << shift, place + 1, shift + 7
        if byte < 0x80:
            break
    return value, place
