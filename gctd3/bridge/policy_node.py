"""The policy as a node: readings from topics, desired angles onto topics. Needs NumPy, onnxruntime and ROS only."""

from __future__ import annotations

import math
import sys
import time
from dataclasses import dataclass
from typing import Any

from gctd3.bridge.messages import NANO, MessageError, Topic, Velocity
from gctd3.bridge.middleware import Middleware
from gctd3.bridge.names import CLOCK, CMD_VEL, ENDED, IMU, VELOCITY_COMMANDS, Layout, layout_of
from gctd3.bridge.network import choose_for, join
from gctd3.bridge.settings import RosSettings
from gctd3.deploy.policy import Policy
from gctd3.errors import MiddlewareError, ReadingError

MISSED = (
    1.5  # control periods without readings, or one of their topics, until it counts as missed, with the time of day
)
GRACE = 0.25  # control periods for which readings wait for others of the same step, with the time of day
TO_HOME = 10.0  # longest time of the safe command before the node leaves (s)


@dataclass
class PolicyCounts:
    """Count what a policy's node did.

    Attributes:
        steps: Control steps in which the policy chose the command.
        refused: Readings that were refused.
        limited: Steps in which the change of a desired angle was limited.
    """

    steps: int = 0
    refused: int = 0
    limited: int = 0


class PolicyNode:
    """Answer readings with desired angles until the simulator ends, or the readings do.

    Args:
        settings: The settings.
        policy: The policy.
        link: The network.
        layout: The topics.
    """

    def __init__(self, settings: RosSettings, policy: Policy, link: Middleware, layout: Layout) -> None:
        self.settings, self.policy, self.link, self.layout = settings, policy, link, layout
        self.counts = PolicyCounts()
        self._lockstep = settings.clock == "lockstep"
        self._period = 1.0 / policy.contract.control_rate_hz
        self._values: dict[str, float] = {}
        self._fresh: set[Topic] = set()
        self._episode: str | None = None
        self._stamp, self._turned = 0, 0
        self._arrived: dict[Topic, float] = {}
        self._velocity, self._velocity_time = Velocity(0.0, 0.0, 0.0), -math.inf
        self._walking = False
        self._last_reason = ""
        link.subscribe([*layout.sensors, CLOCK, ENDED, *([CMD_VEL] if policy.contract.commands else [])])
        link.advertise(layout.commands)

    def run(self) -> None:
        """Run until the simulator says that it has ended.

        Raises:
            MiddlewareError: If no good readings come any more; the safe command has been published by then.
        """
        self.link.meet([*self.layout.sensors, *self.layout.commands], self.settings.wait, _say)
        _say(f"Connected ({self.link.where}).")
        good = watched = time.monotonic()
        # With the time of day a step without readings is one with the safe command, once there has been one with.
        pause = self.settings.patience if self._lockstep else self._period / 8
        while True:
            item = self.link.receive(pause)
            now = time.monotonic()
            if item is not None and item[0] == ENDED:
                return
            if item is not None and item[0] == CLOCK:
                # A simulator that is paused shows its clock, and nothing else.
                good = watched = now
            elif item is not None and self._take(*item):
                watched = now
            if self._complete(now):
                if self._answer():
                    good = now
                watched = now
            elif not self._lockstep and self.counts.steps and now - watched > MISSED * self._period:
                self._refuse(f"No readings for {now - watched:.3f} s.")
                watched += self._period
            if now - good > self.settings.patience:
                self._retire(now - good)

    def _take(self, topic: Topic, message: Any) -> bool:  # noqa: ANN401
        """Take a message, and return whether it was a good one."""
        if topic == CMD_VEL:
            self._velocity, self._velocity_time = message, self._stamp / NANO
            return False
        try:
            self._values |= self.layout.unpack_reading(topic, message)
        except MessageError as error:
            self._refuse(str(error))
            return False
        self._fresh.add(topic)
        self._arrived[topic] = time.monotonic()
        if topic == IMU:
            self._turned = message.stamp
        if topic == self.layout.joints:
            if self._episode is not None and message.frame != self._episode:
                # The robot was put back to its start.
                self.policy.reset(at_home=True)
                self._walking = False
            self._episode = message.frame
            # A driver that does not stamp its readings has just taken them.
            self._stamp = message.stamp or self.link.now()
        return True

    def _complete(self, now: float) -> bool:
        """Tell whether there is a new reading of every topic, or enough of them with the time of day."""
        if self.layout.joints not in self._fresh or len(self._values) < len(self.policy.contract.readings):
            return False
        whole = len(self._fresh) == len(self.layout.sensors)
        return whole or (not self._lockstep and now - self._arrived[self.layout.joints] > GRACE * self._period)

    def _answer(self) -> bool:
        """Publish the policy's command for the readings, or the safe one, and return whether it was the policy's."""
        policy, when = self.policy, self._stamp / NANO
        self._fresh.clear()
        if reason := self._outdated():
            self._refuse(reason)
            return False
        try:
            if self.settings.home_first and not self._walking:
                command = policy.start(self._values)
                self._walking = policy.at_home
            else:
                now = None if self._lockstep else self.link.now() / NANO
                command = policy.step(self._values, when, now, self._commands(when) or None)
                self.counts.steps += 1
        except ReadingError as error:
            self._report(str(error))
            self._publish(error.command, self._stamp)
            return False
        self._publish(command, self._stamp)
        self._last_reason = ""
        return True

    def _outdated(self) -> str | None:
        """Return why the newest readings are not all of the control period of the joints' states."""
        if self._lockstep:
            return None
        most, joints = MISSED * self._period, self.layout.joints
        for topic in self.layout.sensors:
            if self._arrived[joints] - self._arrived[topic] > most:
                return f"{topic.name} is silent."
        # An inertial unit that does not stamp its message has just measured.
        age = (self._stamp - self._turned) / NANO if self._turned else 0.0
        return f"{IMU.name} is stale: it is {age:.3f} s older than {joints.name}." if age > most else None

    def _commands(self, when: float) -> dict[str, float]:
        """Return the contract's commands by the newest velocity, 0 for one that is old, within their ranges."""
        stands = when - self._velocity_time > self.settings.command_timeout
        asked = {
            name: 0.0 if stands else getattr(self._velocity, VELOCITY_COMMANDS.get(name, ""), 0.0)
            for name in self.policy.contract.commands
        }
        return {
            name: min(max(asked[name], low), high) if math.isfinite(asked[name]) else min(max(0.0, low), high)
            for name, (low, high) in self.policy.contract.commands.items()
        }

    def _publish(self, angles: dict[str, float], stamp: int) -> None:
        for topic, message in self.layout.pack_command(stamp, self._episode or "", angles):
            self.link.publish(topic, message)

    def _report(self, reason: str) -> None:
        self.counts.refused += 1
        # One that goes on is said once.
        if reason[:20] != self._last_reason[:20]:
            _say(f"Refused: {reason} The safe command is in force.")
        self._last_reason = reason

    def _refuse(self, reason: str) -> None:
        """Count a control period without good readings, and publish the safe command."""
        self._report(reason)
        self._publish(self._safe(), self.link.now() if not self._lockstep else self._stamp)

    def _safe(self) -> dict[str, float]:
        """Return the safe command of one more control period without good readings."""
        try:
            self.policy.step({}, math.nan)
        except ReadingError as error:
            return error.command
        raise AssertionError("A policy has accepted no readings.")

    def _retire(self, silent: float) -> None:
        """Say so, publish the safe command until the home pose, and end."""
        text = f"No good readings for {silent:.1f} s ({self.link.where})"
        _say(f"{text}: the safe command is in force, and this node ends.")
        until = time.monotonic() + TO_HOME
        while self.policy.phase != "home" and time.monotonic() < until:
            self._publish(self._safe(), self.link.now() if not self._lockstep else self._stamp)
            time.sleep(self._period)
        raise MiddlewareError(f"{text}; the last command was the safe one, phase {self.policy.phase!r}.")


def _say(line: str) -> None:
    print(f"policy: {line}", file=sys.stderr, flush=True)


def check_commands(policy: Policy) -> None:
    """Raise a :class:`.MiddlewareError` if a policy follows commands that /cmd_vel does not hold."""
    if other := [name for name in policy.contract.commands if name not in VELOCITY_COMMANDS]:
        raise MiddlewareError(f"{CMD_VEL.name} holds no {', '.join(other)}, which this policy follows.")


def run_policy(settings: RosSettings) -> PolicyCounts:
    """Run the policy's node, and return what it did.

    Raises:
        ContractError: If the policy is missing, or does not fit its contract.
        MiddlewareError: If ROS or its master is missing, or good readings have ended.
    """
    policy = Policy(settings.policy)
    check_commands(policy)
    layout = layout_of(policy.contract, settings.names)
    with join(choose_for(settings.middleware, layout), layout.policy, settings.listen) as link:
        node = PolicyNode(settings, policy, link, layout)
        node.run()
    node.counts.limited = policy.limited
    if settings.clock == "lockstep" and node.counts.refused:
        raise MiddlewareError(f"{node.counts.refused} readings were refused, which lock-step has no reason for.")
    return node.counts
