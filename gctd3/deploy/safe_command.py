"""The safe command: what the servos are told in control periods without a good reading, as the contract defines it.

The last good command is held for ``safety.hold_periods`` periods; then each desired angle goes to ``home_rad`` at
``home_rate_rad_s``, and stays. The same motion takes the robot from where it is to its home pose before a walk.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from gctd3.deploy.contract import Contract

Phase = Literal["policy", "hold", "to home", "home"]


class SafeCommand:
    """Keep the command that is in force, and change it while the policy does not.

    Args:
        contract: Contract of the policy.

    Attributes:
        angles: Desired joint angles in force, shape ``[A]`` (rad), always within the servos' limits.
        periods: Control periods since the last good command.
    """

    def __init__(self, contract: Contract) -> None:
        servos = contract.servos
        self._low, self._high = np.array([[servo.low_rad, servo.high_rad] for servo in servos]).T
        self._home = np.array([servo.home_rad for servo in servos])
        self._change = np.array([servo.home_rate_rad_s for servo in servos]) / contract.control_rate_hz
        self._hold = contract.safety.hold_periods
        self.angles, self.periods = self._home.copy(), 0

    @property
    def phase(self) -> Phase:
        """Return whose command is in force: the policy's, or which part of the safe command."""
        if self.periods == 0:
            return "policy"
        if self.periods <= self._hold:
            return "hold"
        return "home" if self.at_home else "to home"

    @property
    def at_home(self) -> bool:
        """Return whether every desired angle is that of the home pose."""
        return bool((self.angles == self._home).all())

    def accept(self, angles: np.ndarray) -> None:
        """Take a good command, shape ``[A]`` (rad); angles outside of the servos' limits are moved to them."""
        self.angles, self.periods = np.clip(angles, self._low, self._high), 0

    def advance(self) -> None:
        """Change the command by one control period without a good one."""
        self.periods += 1
        if self.periods > self._hold:
            self.approach()

    def approach(self) -> None:
        """Move each desired angle to that of the home pose by what its rate allows in a control period."""
        away = self._home - self.angles
        # What is nearer is set, not added, so that the way ends exactly at home.
        self.angles = np.where(
            np.abs(away) <= self._change, self._home, self.angles + np.clip(away, -self._change, self._change)
        )
