"""Sensor readings of one control period: checked against the contract, and put in place as the network's features."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from gctd3.deploy.contract import Contract
from gctd3.deploy.contract_checks import BY_GRAVITY
from gctd3.errors import shown
from gctd3.tasks.slew import approached


class RefusalError(Exception):
    """Carry the reason for which a reading or a time is refused."""


class Readings:
    """Read the values of the contract's readings.

    Args:
        contract: Contract of the policy.
    """

    def __init__(self, contract: Contract) -> None:
        features = contract.features
        names = [str(feature.reading) for feature in features]
        known = set(names)
        places = [(i, k) for i, n in enumerate(contract.nodes) for k, f in enumerate(n.features) if f.reading in known]
        self._features, self._names = features, names
        self._sensors, self._commands = contract.readings, tuple(contract.commands)
        # The command to stand, or the one that is nearest to it.
        self.still = {name: min(max(0.0, low), high) for name, (low, high) in contract.commands.items()}
        # Of each reading, by name in their order; what has no slew rate is not approached, but what it is.
        self.at_rest = np.array([self.still.get(name, 0.0) for name in names])
        rates = np.array([feature.slew_rate for feature in features])
        self._most = np.where(rates > 0, rates / contract.control_rate_hz, math.inf)
        self._shape = len(contract.nodes), len(contract.nodes[0].features)
        self._node, self._feature = np.array(places).T
        self._low, self._high = np.array([[f.low, f.high] for f in features]).T
        self._binary = np.array([f.binary for f in features])
        self._zero = np.array([f.zero for f in features])
        place = {name: i for i, name in enumerate(names)}
        self._clocks = np.array(contract.clocks).reshape(-1, 4).T
        self._own = np.array(contract.own_actions, dtype=np.int64).reshape(-1, 3).T
        self._by_gravity = contract.safety.tilt == BY_GRAVITY
        self._tilt = [place[name] for name in contract.safety.tilt_readings]
        self._angles = [place.get(str(servo.angle_reading)) for servo in contract.servos]

    def read(self, readings: Any, command: Any = None) -> np.ndarray:  # noqa: ANN401 - of a sensor driver, an operator
        """Return the values in the order of ``contract.features``, shape ``[R]``, in their units.

        Args:
            readings: Value of each of ``contract.readings``.
            command: Value of each of ``contract.commands``; ``None`` for a contract without.

        Raises:
            RefusalError: If a value is missing, unknown, not a finite number or beyond its limits.
        """
        given = _given("readings", readings, self._sensors)
        given |= _given("commands", {} if command is None else command, self._commands)
        values = np.array([number(given[name]) for name in self._names])
        finite = np.isfinite(values)
        # Comparisons with NaN are false, so that a value that is none is found as well.
        if (
            not ((values >= self._low) & (values <= self._high)).all()
            or (self._binary & (values != 0.0) & (values != 1.0)).any()
        ):
            self._refuse(given, values, finite)
        return values

    def _refuse(self, given: Mapping[str, Any], values: np.ndarray, finite: np.ndarray) -> None:
        for feature, value, known in zip(self._features, values, finite, strict=True):
            name, unit = str(feature.reading), "" if feature.unit == "1" else f" {feature.unit}"
            if not known:
                expected = "a finite number"
            elif feature.binary and value not in (0.0, 1.0):
                expected = "0 or 1"
            elif not feature.low <= value <= feature.high:
                expected = f"between {feature.low:.6g} and {feature.high:.6g}{unit}"
            else:
                continue
            raise RefusalError(f"{name} must be {expected}, got {shown(given[name])}.")

    def approached(self, values: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Return the values with commands that change by no more than in a control step of the training, shape ``[R]``.

        Args:
            values: Values of the readings, shape ``[R]``.
            last: The same of the last step as this returned them, :attr:`at_rest` before the first one.
        """
        return approached(last, values, self._most)

    def frame(self, values: np.ndarray, action: np.ndarray, elapsed: float) -> np.ndarray:
        """Return the features of every node in one frame, ``float32 [N, features]``.

        Args:
            values: Values of the readings, shape ``[R]``.
            action: The last action, shape ``[A]``.
            elapsed: Time since the first frame (s).
        """
        frame = np.zeros(self._shape, dtype=np.float32)
        frame[self._node, self._feature] = (values - self._zero).astype(np.float32)
        node, feature, servo = self._own
        frame[node, feature] = action[servo]
        *clock, frequency, phase = self._clocks
        frame[tuple(np.array(clock, dtype=np.int64))] = np.sin(2 * np.pi * (frequency * elapsed + phase))
        return frame

    def tilt(self, values: np.ndarray) -> float:
        """Return the angle between the body's vertical and the world's (rad); 0 if nothing measures it."""
        if self._by_gravity:
            upright = -float(values[self._tilt[0]]) if self._tilt else 1.0
        else:
            upright = math.prod(math.cos(values[place]) for place in self._tilt)
        return math.acos(min(max(upright, -1.0), 1.0))

    def joint_angles(self, values: np.ndarray) -> np.ndarray | None:
        """Return the angle of each servo's joint, shape ``[A]`` (rad); ``None`` if one of them is not read."""
        places = [place for place in self._angles if place is not None]
        return values[places] if len(places) == len(self._angles) else None


def _given(what: str, values: Any, names: tuple[str, ...]) -> dict[str, Any]:  # noqa: ANN401
    """Return values by name, if they are those that are named."""
    if not isinstance(values, Mapping):
        raise RefusalError(f"The {what} must be a mapping from names to numbers, got {shown(values)}.")
    try:
        given = dict(values)
    except Exception as error:  # whatever the mapping's own code raises
        raise RefusalError(f"The {what} cannot be read: {type(error).__name__}.") from error
    if given.keys() != set(names):
        missing = ", ".join(name for name in names if name not in given) or "none"
        extra = shown_names([key for key in given if key not in names]) or "none"
        raise RefusalError(f"The {what} do not fit the contract: missing {missing}; unknown {extra}.")
    return given


def shown_names(names: list[Any]) -> str:
    """Return at most five of the names, sorted, as one line."""
    texts = sorted(name if isinstance(name, str) else shown(name) for name in names)
    return ", ".join(shown(text)[1:-1] for text in texts[:5]) + (", ..." if len(texts) > 5 else "")


def number(value: Any) -> float:  # noqa: ANN401 - a sensor driver's output
    """Convert a real number to a float; NaN for texts, arrays with dimensions and everything else."""
    if type(value) is float:
        return value
    try:
        if isinstance(value, (str, bytes)) or np.iscomplexobj(value) or getattr(value, "shape", ()) != ():
            return math.nan
        return float(value)
    except Exception:  # whatever the value's own code raises, a warning that is an error included
        return math.nan
