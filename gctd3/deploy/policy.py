"""Run an exported policy on a robot: named sensor readings in, desired joint angles out.

The loop on a robot::

    policy = gctd3.deploy.Policy("policy.onnx")
    while True:
        readings, time = read_sensors()
        try:
            command = policy.step(readings, time)
        except ReadingError as error:
            command = error.command
        send(command)

Needs only NumPy and onnxruntime, neither PyTorch nor MuJoCo.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from gctd3.deploy.contract import ROBOT, ROBOT_HASH, Contract, read_contract, robot_hash
from gctd3.errors import ContractError, ReadingError
from gctd3.files import checksum

# Time from one step to the next, in control periods: below, the readings are old ones; above, some were missed.
SHORTEST, LONGEST = 0.5, 1.5
_LARGEST = float(np.finfo(np.float32).max)


class Policy:
    """Run an exported policy step by step, with the history of its readings.

    Args:
        path: The ONNX file; its contract is beside it, with the suffix ``.json``.
        robot: MJCF file of the robot on which the policy runs; if given, the policy must have been trained for it.

    Attributes:
        contract: The contract of the policy; ``contract.readings`` names the readings.
        command: The last command, which is safe to hold; before the first step, the pose in which the robot starts.
        limited: Number of steps in which the change of a desired angle was limited to ``most_change_rad``.

    Raises:
        ContractError: If a file is missing or damaged, contract and network do not belong together, or the policy was
            trained for another robot.
        ImportError: If onnxruntime is not installed.
    """

    def __init__(self, path: str | Path, robot: str | Path | None = None) -> None:
        file = Path(path)
        if file.suffix != ".onnx" or not file.is_file():
            raise ContractError(f"No policy at {file}: expected the .onnx file that gctd3.export writes.")
        self.contract: Contract = read_contract(file.with_suffix(".json"))
        if robot is not None and robot_hash(robot) != self.contract.robot.sha256:
            raise ContractError(
                f"{file} is of another robot: it was trained for {self.contract.robot.name!r}, whose MJCF is not "
                f"{robot}."
            )
        self._session = _open(file, self.contract)
        servos = self.contract.servos
        self._low, self._high = np.array([[servo.low_rad, servo.high_rad] for servo in servos]).T
        self._centre, self._scale = np.array([[servo.centre_rad, servo.scale_rad] for servo in servos]).T
        self._start = np.array([servo.start_rad for servo in servos])
        self._most = np.array([servo.most_change_rad for servo in servos])
        features = [(i, k, f) for i, n in enumerate(self.contract.nodes) for k, f in enumerate(n.features) if f.reading]
        self._names = self.contract.readings
        self._node, self._feature = np.array([[i, k] for i, k, _ in features]).T
        self._binary = np.array([f.binary for _, _, f in features])
        self._zero = np.array([f.zero for _, _, f in features])
        self.reset()

    def reset(self) -> None:
        """Begin a new walk: clear the history and return to the pose in which the robot starts."""
        self._frames: np.ndarray | None = None
        self._time = -math.inf
        self._desired = self._start.copy()
        self.limited = 0

    @property
    def command(self) -> dict[str, float]:
        """Return the desired joint angles (rad) by the name of the actuator."""
        servos = self.contract.servos
        return {servo.actuator: float(angle) for servo, angle in zip(servos, self._desired, strict=True)}

    def step(self, readings: Mapping[str, float], time: float, now: float | None = None) -> dict[str, float]:
        """Compute the desired joint angles of one control step from the readings.

        Refused readings leave the state unchanged, so that valid readings may follow in time. Only if steps were missed
        the history is cleared, and the next readings begin a new one.

        Args:
            readings: Value of each of ``contract.readings``, not normalised: angles in rad, contacts 0 or 1.
            time: Time of the readings (s), on any steady clock.
            now: Current time of that clock (s); if given, readings older than a control period are refused.

        Returns:
            Desired joint angles by the name of the actuator (rad), within the servos' limits.

        Raises:
            ReadingError: If a reading is missing, unknown, not a finite number or too old, steps were missed, or the
                network's output is not finite; its ``command`` is the last one.
        """
        frame = self._frame(readings)
        self._check_time(time, now)
        frames = self.contract.history_frames
        before = self._frames if self._frames is not None else np.stack([frame] * frames)
        stack = np.concatenate([before[1:], frame[None]])
        nodes = stack.transpose(1, 0, 2).reshape(1, *self.contract.network.input_shape)
        action = self._run(nodes)
        if not np.isfinite(action).all():
            raise self._refuse(f"The policy's output is not finite: {action.tolist()}.")
        desired = np.clip(self._centre + self._scale * action.astype(np.float64), self._low, self._high)
        allowed = np.clip(desired, self._desired - self._most, self._desired + self._most)
        self.limited += int((allowed != desired).any())
        self._frames, self._time, self._desired = stack, time, allowed
        return self.command

    def _frame(self, readings: Mapping[str, Any]) -> np.ndarray:
        """Return the features of every node in one frame, shape ``[N, features]``."""
        given, names = set(readings), set(self._names)
        if given != names:
            missing = ", ".join(name for name in self._names if name not in given) or "none"
            extra = ", ".join(sorted(map(str, given - names))) or "none"
            raise self._refuse(f"The readings do not fit the contract: missing {missing}; unknown {extra}.")
        exact = np.array([_number(readings[name]) for name in self._names], dtype=np.float64)
        # A number beyond float32 becomes infinite, and is refused as such.
        with np.errstate(over="ignore", invalid="ignore"):
            values = (exact - self._zero).astype(np.float32)
        for wrong, expected in (
            (~np.isfinite(values), "a finite number"),
            (self._binary & (exact != 0.0) & (exact != 1.0), "0 or 1"),
        ):
            if wrong.any():
                name = self._names[int(wrong.argmax())]
                raise self._refuse(f"{name} must be {expected}, got {readings[name]!r}.")
        nodes = self.contract.nodes
        frame = np.zeros((len(nodes), len(nodes[0].features)), dtype=np.float32)
        frame[self._node, self._feature] = values
        return frame

    def _check_time(self, time: float, now: float | None) -> None:
        period = 1.0 / self.contract.control_rate_hz
        since = (time - self._time) / period
        if not math.isfinite(time):
            raise self._refuse(f"time must be finite, got {time}.")
        if since < SHORTEST:
            raise self._refuse(
                f"Stale readings: they are {since * period:.4f} s newer than those before, expected {period:.4f} s."
            )
        if LONGEST < since < math.inf:
            self._frames, self._time = None, -math.inf
            raise self._refuse(
                f"Steps were missed: the readings are {since * period:.4f} s newer than those before, expected "
                f"{period:.4f} s. The next ones begin a new history."
            )
        if now is not None and not 0.0 <= now - time <= period:
            raise self._refuse(
                f"Stale readings: they are {now - time:.4f} s old, expected between 0 and {period:.4f} s."
            )

    def _run(self, nodes: np.ndarray) -> np.ndarray:
        network = self.contract.network
        action: np.ndarray = self._session.run([network.output], {network.input: nodes})[0][0]
        return action

    def _refuse(self, message: str) -> ReadingError:
        return ReadingError(message, self.command)


def _number(value: Any) -> float:  # noqa: ANN401 - a sensor driver's output
    """Convert a reading to a float; NaN if it is not a number, or too large for float32."""
    try:
        number = math.nan if isinstance(value, (str, bytes)) else float(value)
    except (TypeError, ValueError, OverflowError):
        return math.nan
    return number if abs(number) <= _LARGEST else math.nan


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
        raise ContractError(f"{what} is no ONNX file that onnxruntime can run: {error}") from error


def _open(file: Path, contract: Contract) -> Any:  # noqa: ANN401
    """Open the network of a contract.

    Raises:
        ContractError: If the file does not belong to the contract.
    """
    session = open_session(file)
    metadata = session.get_modelmeta().custom_metadata_map
    if metadata.get(ROBOT_HASH, contract.robot.sha256) != contract.robot.sha256:
        raise ContractError(
            f"{file} is of another robot than its contract: of {metadata.get(ROBOT)!r}, the contract of "
            f"{contract.robot.name!r} ({file.with_suffix('.json')})."
        )
    if checksum(file) != contract.network.sha256:
        raise ContractError(
            f"{file} and {file.with_suffix('.json')} do not belong together: the checksum in the contract is of "
            "another file. Export both again, or copy both."
        )
    return session
