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
from pathlib import Path
from typing import Any

import numpy as np

from gctd3.deploy.contract import Contract, read_contract, robot_hash
from gctd3.deploy.network import open_network
from gctd3.deploy.readings import Readings, RefusalError, number
from gctd3.deploy.safe_command import Phase, SafeCommand
from gctd3.errors import ContractError, ReadingError, one_line, shown

# Least time from one reading to the next, in control periods: readings that come sooner are old ones.
SHORTEST = 0.5


class Policy:
    """Run an exported policy step by step, with the history of its readings.

    :meth:`step`, or :meth:`start` before it, is to be called once a control period, whatever the sensors give; a call
    without a good reading raises a :class:`.ReadingError` with a safe command.

    Args:
        path: The ONNX file; its contract is beside it, with the suffix ``.json``.
        robot: Robot on which the policy runs, see :func:`.robot_hash`: a run's copy of it, or its MJCF file; if given,
            the policy must have been trained for it.

    Attributes:
        contract: The contract of the policy; ``contract.readings`` names the readings, and ``contract.commands`` the
            commands of a policy that follows them, with their ranges.
        at_home: Whether the last call was a :meth:`start` that arrived at the home pose.
        limited: Number of steps in which the change of a desired angle was limited to ``most_change_rad``.
        stopped: Reason for which the policy has stopped until :meth:`reset`; ``None`` if it has not.

    Raises:
        ContractError: If a file is missing or damaged, contract and network do not fit each other, or the policy was
            trained for another robot.
        ImportError: If onnxruntime is not installed.
    """

    def __init__(self, path: str | Path, robot: str | Path | None = None) -> None:
        file = Path(path)
        if file.suffix != ".onnx" or not file.is_file():
            raise ContractError(f"No policy at {file}: expected the .onnx file that gctd3.export writes.")
        self.contract: Contract = read_contract(file.with_suffix(".json"))
        if robot is not None and (found := robot_hash(robot)) != self.contract.robot.sha256:
            raise ContractError(
                f"{file} is of another robot: it was trained for {self.contract.robot.name!r}, whose MJCF is not "
                f"{robot} (hash {self.contract.robot.sha256[:12]}, not {found[:12]}). Of a robot that settings "
                "complete give the copy that its run keeps, RUN/robot."
            )
        self._session = open_network(file, self.contract)
        servos = self.contract.servos
        self._centre, self._scale = np.array([[servo.centre_rad, servo.scale_rad] for servo in servos]).T
        self._low, self._high = np.array([[servo.low_rad, servo.high_rad] for servo in servos]).T
        self._most = np.array([servo.most_change_rad for servo in servos])
        self._period = 1.0 / self.contract.control_rate_hz
        self._readings = Readings(self.contract)
        self.reset(at_home=True)

    def reset(self, at_home: bool = False) -> None:
        """Begin anew: forget history, clock and stop. Needed after a stop, and after the clock was set back.

        Args:
            at_home: Whether the robot has been put into its home pose meanwhile, as simulators do; the command is then
                that pose. By default the command stays, so that it does not jump.
        """
        self._forget()
        self._starting = self.at_home = False
        self.stopped: str | None = None
        self.limited = 0
        if at_home:
            self._safe = SafeCommand(self.contract)

    def _forget(self) -> None:
        """Forget the history and the clock."""
        self._frames: np.ndarray | None = None
        self._told = self._readings.at_rest
        self._action = np.zeros(len(self.contract.servos), dtype=np.float32)
        self._time = self._frame_time = -math.inf
        self._began: float | None = None
        self._late: float | None = None

    @property
    def command(self) -> dict[str, float]:
        """Return the desired joint angles in force (rad) by the name of the actuator; at first the home pose."""
        servos, angles = self.contract.servos, self._safe.angles.tolist()
        return {servo.actuator: angle for servo, angle in zip(servos, angles, strict=True)}

    @property
    def phase(self) -> Phase:
        """Return whose command is in force: ``policy``, or ``hold``, ``to home`` or ``home`` of the safe command."""
        return self._safe.phase

    def start(self, readings: Mapping[str, float]) -> dict[str, float]:
        """Move the robot to its home pose before a walk, one control period a call, until :attr:`at_home`.

        The first call takes the desired angles from where the joints are; each call moves them by ``home_rate_rad_s``.

        Args:
            readings: As in :meth:`step`.

        Returns:
            Desired joint angles by the name of the actuator (rad).

        Raises:
            ReadingError: As in :meth:`step`.
            ContractError: If the policy does not read the angle of every joint.
        """
        try:
            # On the way to its home pose the robot follows no command.
            values = self._read(readings, self._readings.still or None)
        except RefusalError as refusal:
            raise self._refuse(refusal) from None
        angles = self._readings.joint_angles(values)
        if angles is None:
            raise ContractError("This policy does not read the angle of every joint, so it cannot be started from it.")
        if not self._starting:
            self._forget()
            self._starting = True
            self._safe.accept(angles)
        self._safe.accept(self._safe.angles)
        self._safe.approach()
        self.at_home = self._safe.at_home
        return self.command

    def step(
        self,
        readings: Mapping[str, float],
        time: float,
        now: float | None = None,
        command: Mapping[str, float] | None = None,
    ) -> dict[str, float]:
        """Compute the desired joint angles of one control step from the readings.

        A refused reading costs its own control period only: good ones may follow in the next. A late reading is used,
        up to ``safety.hold_periods`` missed periods; a later one is refused. Frames that are missing since the last
        good reading are filled with it, up to as many; after more of them the history begins anew.

        Args:
            readings: Value of each of ``contract.readings``, not normalised: angles in rad, contacts 0 or 1.
            time: Time of the readings (s), on any steady clock.
            now: Current time of that clock (s); if given, readings older than a control period are refused.
            command: Value of each of ``contract.commands`` for this step, within its range, of a policy that follows
                commands: ``{"command_forward_m_s": 0.5, "command_side_m_s": 0.0, "command_turn_rad_s": 0.0}``. The
                policy is told commands that approach it by at most ``slew_rate`` a second, as in its training, from
                standing still on.

        Returns:
            Desired joint angles by the name of the actuator (rad), within the servos' limits.

        Raises:
            ReadingError: If a reading or a command is missing, unknown, not a finite number or beyond its limits,
                readings are too old or too late, time is not a finite number or goes backwards, the body is tilted too
                far, or the network's output is not finite; its ``command`` is safe to send.
        """
        self._starting = self.at_home = False
        try:
            when = self._at(time, now)
            anew = self._frames is None or self._missed(when) >= self.contract.safety.hold_periods + 0.5
            told_before = self._readings.at_rest if anew else self._told
            told = self._readings.approached(self._read(readings, command), told_before)
            began = when if self._began is None else self._began
            frame = self._readings.frame(told, self._action, when - began)
            stack = self._history(None if anew else self._frames, frame, when)
            action = self._run(stack)
        except RefusalError as refusal:
            raise self._refuse(refusal) from None
        desired = np.clip(self._centre + self._scale * action.astype(np.float64), self._low, self._high)
        last = self._safe.angles
        allowed = np.clip(desired, last - self._most, last + self._most)
        self.limited += int((allowed != desired).any())
        self._frames, self._frame_time, self._action, self._began = stack, when, action, began
        self._told = told
        self._safe.accept(allowed)
        return self.command

    def _at(self, time: Any, now: Any) -> float:  # noqa: ANN401 - a sensor driver's output
        """Return the time of the readings, which becomes that of the clock; refuse one that cannot be true."""
        when, current = number(time), 0.0 if now is None else number(now)
        for name, given, value in (("time", time, when), ("now", now, current)):
            if not math.isfinite(value):
                raise RefusalError(f"{name} must be a finite number of seconds, got {shown(given)}.")
        if when < self._time:
            raise RefusalError(f"The clock went back by {self._time - when:.4f} s. If it was set back, call reset().")
        period, newer = self._period, when - self._frame_time
        if newer < SHORTEST * period:
            raise RefusalError(
                f"Stale readings: they are {newer:.4f} s newer than those before, expected {period:.4f} s."
            )
        age = current - when
        if now is not None and age < 0:
            raise RefusalError(f"The readings come from the future: time is {-age:.4f} s after now.")
        self._check_late(when)
        # Whatever the readings are, their period has passed.
        self._time, self._late = when, None
        if now is not None and age > period:
            raise RefusalError(f"Stale readings: they are {age:.4f} s old, expected between 0 and {period:.4f} s.")
        return when

    def _check_late(self, when: float) -> None:
        """Refuse readings after more missed periods than the contract allows, unless the last ones came then, too.

        So a single wrong time does not set the clock forward.
        """
        hold = self.contract.safety.hold_periods
        most, since, late = (hold + 1.5) * self._period, when - self._time, self._late
        if not most < since < math.inf or (late is not None and 0 <= when - late <= most):
            return
        self._late = when
        raise RefusalError(
            f"Steps were missed: the readings are {since:.4f} s newer than those before, expected {self._period:.4f} "
            f"s; at most {hold} may be missed. The next ones begin a new history."
        )

    def _read(self, readings: Any, command: Any) -> np.ndarray:  # noqa: ANN401
        """Return the values of readings and commands, shape ``[R]``; stop if the body is tilted too far."""
        if self.stopped is not None:
            raise RefusalError(self.stopped)
        values, most = self._readings.read(readings, command), self.contract.safety.most_tilt_rad
        tilt = self._readings.tilt(values)
        if most is not None and tilt > most:
            self.stopped = (
                f"Stopped: the body was tilted by {tilt:.3f} rad, allowed are {most:.3f} rad. Call reset() to go on."
            )
            raise RefusalError(self.stopped)
        return values

    def _missed(self, when: float) -> float:
        """Return how many periods were missed since the last frame."""
        return max((when - self._frame_time) / self._period - 1.0, 0.0)

    def _history(self, before: np.ndarray | None, frame: np.ndarray, when: float) -> np.ndarray:
        """Return the history with a new frame, shape ``[frames, N, features]``; a new one if there is none before."""
        frames = self.contract.history_frames
        if before is None:
            return np.stack([frame] * frames)
        filled = [before, *[before[-1:]] * min(round(self._missed(when)), frames), frame[None]]
        return np.concatenate(filled)[-frames:]

    def _run(self, stack: np.ndarray) -> np.ndarray:
        """Return the action of a history, shape ``[A]``."""
        network = self.contract.network
        nodes = stack.transpose(1, 0, 2).reshape(1, *network.input_shape)
        try:
            action: np.ndarray = self._session.run([network.output], {network.input: nodes})[0][0]
        except Exception as error:  # onnxruntime's errors share no base class
            raise RefusalError(f"The network failed: {one_line(error)}.") from error
        if not np.isfinite(action).all():
            raise RefusalError(f"The policy's output is not finite: {action.tolist()}.")
        return action

    def _refuse(self, refusal: RefusalError) -> ReadingError:
        self._safe.advance()
        self.at_home = False
        return ReadingError(str(refusal), self.command)
