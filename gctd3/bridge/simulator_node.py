"""The simulator as a node: publishes readings, takes desired angles, and goes on by the safe command without them."""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path

import numpy as np

from gctd3.bridge.messages import NANO, JointSample, MessageError, Topic
from gctd3.bridge.middleware import Middleware
from gctd3.bridge.names import CLOCK, ENDED, Layout, layout_of
from gctd3.bridge.network import choose_for, join
from gctd3.bridge.plant import Plant, plant_of
from gctd3.bridge.settings import RosSettings
from gctd3.bridge.walk import Walk
from gctd3.deploy.contract import Contract, read_contract
from gctd3.deploy.policy import Policy
from gctd3.deploy.safe_command import SafeCommand
from gctd3.errors import MiddlewareError, ReadingError

BEGIN = 1 * NANO  # simulated time of the first step (ns): a time of 0 means none in ROS
GRACE = 0.25  # control periods that the physics waits for a command, with the time of day; a later one is late
STALE = 1.5  # control periods after which a command's readings are too old
BEAT = 0.2  # between two messages of the clock while paused (s)
FAREWELL = 0.5  # for the last message to arrive (s)


class SimulatorNode:
    """Simulate a robot whose servos follow the topics of commands.

    Args:
        settings: The settings.
        plant: The robot.
        link: The network.
        layout: The topics.
    """

    def __init__(self, settings: RosSettings, plant: Plant, link: Middleware, layout: Layout) -> None:
        self.settings, self.plant, self.link, self.layout = settings, plant, link, layout
        self._period = plant.task.control_dt
        self._lockstep = settings.clock == "lockstep"
        self._safe = SafeCommand(plant.contract)
        self._walk = Walk("", 0.0, 0, self._period, plant.qpos)
        self._paused, self._reset = threading.Event(), threading.Event()
        self._episode, self._ticks = 1, 0
        self._angles: dict[str, float] = {}
        self._fresh: set[Topic] = set()
        link.advertise([*layout.sensors, CLOCK, ENDED])
        link.subscribe(layout.commands)
        reset, pause, unpause = layout.services
        link.serve(reset, self._reset.set)
        link.serve(pause, self._paused.set)
        link.serve(unpause, self._paused.clear)

    def run(self) -> Walk:
        """Simulate until the walk ends.

        Raises:
            MiddlewareError: If there are no good commands any more; the robot has followed the safe command by then.
        """
        self.link.meet([*self.layout.sensors, *self.layout.commands], self.settings.wait, _say)
        _say(f"Connected ({self.link.where}).")
        step = self._step_together if self._lockstep else self._step_in_time
        self._due = time.monotonic()
        silent, told, walk = 0.0, False, self._walk
        while self.plant.ended is None:
            self._wait_while_paused()
            if self._reset.is_set():
                self._reset.clear()
                self._restart()
            silent = 0.0 if step() else silent + self._period
            if silent > self.settings.patience or (silent and (self._lockstep or self.plant.ended)):
                self._retire(self.settings.patience if self._lockstep else silent)
            if silent and self._safe.phase == "to home" and not told:
                told = True
                _say(f"No good command for {silent:.2f} s: the robot follows the safe command.")
        walk.ended, walk.distance, walk.steps = self.plant.ended, self.plant.distance, self.plant.steps
        walk.qpos = self.plant.qpos
        self.link.publish(ENDED, walk.ended)
        time.sleep(FAREWELL)
        return walk

    def _restart(self) -> None:
        self.plant.reset()
        self._safe = SafeCommand(self.plant.contract)
        self._episode += 1

    def _wait_while_paused(self) -> None:
        """Show the clock, which stands, until the simulation is resumed."""
        if not self._paused.is_set():
            return
        while self._paused.is_set():
            self.link.publish(CLOCK, self._time())
            time.sleep(BEAT)
        self._due = time.monotonic()

    def _time(self) -> int:
        """Return the time of the readings (ns)."""
        return BEGIN + self._ticks * round(self._period * NANO) if self._lockstep else self.link.now()

    def _publish(self) -> int:
        stamp = self._time()
        self._fresh.clear()
        imu = self.plant.imu(stamp) if self.layout.inertial else None
        frame = f"episode {self._episode}"
        for topic, message in self.layout.pack_readings(stamp, frame, self.plant.readings(), imu):
            self.link.publish(topic, message)
        self.link.publish(CLOCK, stamp)
        self._ticks += 1
        return stamp

    def _take(self, stamp: int, timeout: float) -> bool:
        """Wait for a message, and return whether the command of the readings with this stamp is complete."""
        item = self.link.receive(timeout)
        if item is None:
            return False
        topic, message = item
        try:
            self._angles |= self.layout.unpack_command(topic, message)
            if isinstance(message, JointSample):
                self._check_stamp(topic, message.stamp, stamp)
            if not all(np.isfinite(angle) for angle in self._angles.values()):
                self._angles = {}
                raise MessageError(f"{topic.name} has an angle that is not finite.")
        except MessageError as error:
            self._walk.refused += 1
            _say(f"Refused: {error}")
            return False
        self._fresh.add(topic)
        return len(self._fresh) == len(self.layout.commands)

    def _check_stamp(self, topic: Topic, given: int, expected: int) -> None:
        age = (expected - given) / NANO
        if abs(age) > (0.0 if self._lockstep else STALE * self._period):
            raise MessageError(
                f"{topic.name} is stale: it answers readings that are {age:.3f} s older than those it has to answer."
            )

    def _accept(self, began: float) -> None:
        """Let the servos follow a complete command."""
        self._walk.round_trips.append(time.perf_counter() - began)
        self._safe.accept(np.array([self._angles[servo.actuator] for servo in self.plant.contract.servos]))
        self.plant.command(self._commanded())

    def _commanded(self) -> dict[str, float]:
        names = [servo.actuator for servo in self.plant.contract.servos]
        return dict(zip(names, self._safe.angles.tolist(), strict=True))

    def _step_together(self) -> bool:
        """Take a control step in lock-step, and return whether there was a command for it."""
        began, stamp = time.perf_counter(), self._publish()
        while not self._take(stamp, self.settings.patience - (time.perf_counter() - began)):
            if time.perf_counter() - began > self.settings.patience:
                return False
        self._accept(began)
        for _ in range(self.plant.substeps):
            self.plant.substep()
        self.plant.finish_step()
        return True

    def _step_in_time(self) -> bool:
        """Take a control step with the time of day, and return whether a command came within it.

        The physics begins with the command, or after a quarter of the period without; a later command takes effect with
        the next step of the physics.
        """
        self._due += self._period
        # Behind by more than a period, as after a suspended process: what is lost is not caught up with.
        self._due = max(self._due, time.monotonic())
        while (left := self._due - time.monotonic()) > 0:
            time.sleep(left)
        began, stamp = time.perf_counter(), self._publish()
        answered = self._await(stamp, began, self._due + GRACE * self._period)
        late = not answered
        for i in range(self.plant.substeps):
            at = self._due + (GRACE + (1 - GRACE) * i / self.plant.substeps) * self._period
            if not answered:
                answered = self._await(stamp, began, at)
            else:
                time.sleep(max(at - time.monotonic(), 0.0))
            if not answered and i == 0:
                self._safe.advance()
                self.plant.command(self._commanded())
            self.plant.substep()
        self.plant.finish_step()
        self._walk.late += int(late and answered)
        self._walk.missed += int(not answered)
        return answered

    def _await(self, stamp: int, began: float, until: float) -> bool:
        """Wait for the command of the readings until a time, and return whether it came."""
        while True:
            if self._take(stamp, until - time.monotonic()):
                self._accept(began)
                return True
            if time.monotonic() >= until:
                return False

    def _retire(self, silent: float) -> None:
        """Say so, let the robot follow the safe command to its home pose, and end."""
        text = f"No good command for {silent:.1f} s ({self.link.where})"
        _say(f"{text}: the robot follows the safe command, and this node ends.")
        most = round(10.0 / self._period)
        while self._safe.phase != "home" and most and self.plant.ended is None:
            self._safe.advance()
            self.plant.step(self._commanded())
            most -= 1
        raise MiddlewareError(
            f"{text}; after {self.plant.steps} steps the robot is at {self.plant.distance:.3f} m, phase "
            f"{self._safe.phase!r} of the safe command{', and has fallen' if self.plant.ended == 'fall' else ''}."
        )


def _say(line: str) -> None:
    print(f"simulator: {line}", file=sys.stderr, flush=True)


def contract_of(settings: RosSettings) -> Contract:
    """Read the contract beside the policy."""
    return read_contract(Path(settings.policy).with_suffix(".json"))


def run_simulator(settings: RosSettings) -> Walk:
    """Run the simulator's node until the walk ends.

    Raises:
        ContractError: If the policy's contract is missing, or for another robot.
        MiddlewareError: If ROS or its master is missing, or good commands have ended.
    """
    contract = contract_of(settings)
    layout = layout_of(contract, settings.names)
    chosen = choose_for(settings.middleware, layout)
    plant = plant_of(settings.run, contract, settings.seed, settings.seconds)
    with join(chosen, layout.simulator, settings.listen) as link:
        return SimulatorNode(settings, plant, link, layout).run()


def run_without_ros(settings: RosSettings) -> Walk:
    """Run the same walk in one process, the policy called where the nodes exchange messages.

    Raises:
        ContractError: If the policy is missing, or for another robot.
    """
    policy, contract = Policy(settings.policy), contract_of(settings)
    plant = plant_of(settings.run, contract, settings.seed, settings.seconds)
    walk, period = Walk("", 0.0, 0, plant.task.control_dt, plant.qpos), round(plant.task.control_dt * NANO)
    stands = {name: min(max(0.0, low), high) for name, (low, high) in contract.commands.items()}
    while plant.ended is None:
        readings = plant.readings()
        try:
            when = (BEGIN + plant.steps * period) / NANO
            command = policy.step({name: readings[name] for name in contract.readings}, when, None, stands or None)
        except ReadingError as error:
            command, walk.refused = error.command, walk.refused + 1
        plant.step(command)
    walk.ended, walk.distance, walk.steps, walk.qpos = plant.ended, plant.distance, plant.steps, plant.qpos
    return walk
