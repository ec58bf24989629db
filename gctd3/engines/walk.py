"""One episode of a policy in an engine: readings by the task's own table, actions by the policy's contract alone."""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco
import numpy as np

from gctd3.deploy.policy import Policy
from gctd3.engines.engine import Engine
from gctd3.errors import ReadingError
from gctd3.robots.geometry import lowest_point
from gctd3.robots.ground import contact_sensors
from gctd3.robots.mjcf import colliding_geoms
from gctd3.tasks.features import Sensed
from gctd3.tasks.measurement import Measurement
from gctd3.tasks.memory import Memory
from gctd3.tasks.simulated_task import SimulatedTask


@dataclass(frozen=True)
class Walk:
    """Hold the record of one episode of ``T`` control steps.

    Attributes:
        position: Distance walked, shape ``[T]`` (m).
        height: Body height from standing, shape ``[T]`` (m).
        angles: Joint angles, shape ``[T, J]`` (rad).
        rates: Joint velocities, shape ``[T, J]`` (rad/s).
        feet_down: Contact of each foot, shape ``[T, feet]``.
        lowest: Height of the feet's lowest point, shape ``[T]`` (m).
        torque: Root mean square of each servo's torque in each step, shape ``[T, A]`` (N m).
        peak: Largest torque of each servo in each step, shape ``[T, A]`` (N m).
        desired: Desired angles, shape ``[T, A]`` (rad).
        finished: Whether the episode ended with success.
        fell: Whether it was terminated.
        refused: A line for each reading that the policy refused.
    """

    position: np.ndarray
    height: np.ndarray
    angles: np.ndarray
    rates: np.ndarray
    feet_down: np.ndarray
    lowest: np.ndarray
    torque: np.ndarray
    peak: np.ndarray
    desired: np.ndarray
    finished: bool
    fell: bool
    refused: tuple[str, ...] = field(default=())

    def speed(self, dt: float) -> float:
        """Compute the mean speed, distance over time (m/s)."""
        return float(self.position[-1]) / (len(self.position) * dt)


class Sensing:
    """Measure an engine's state as the task measures MuJoCo's.

    Args:
        task: The task.
    """

    def __init__(self, task: SimulatedTask) -> None:
        self.task, self.model = task, task.robot.model
        self._data = mujoco.MjData(self.model)
        self._contacts = contact_sensors(self.model, task.robot.base.root)
        self._geoms = [g for body in task.robot.foot_bodies for g in colliding_geoms(self.model, body)]

    def __call__(self, engine: Engine) -> tuple[Measurement, float, bool]:
        """Return the measurement, the height of the feet's lowest point (m), and whether the state is finite."""
        qpos, qvel = engine.state()
        # MuJoCo starts a robot anew whose state is not finite, or its numbers huge.
        if engine.exploded or not (np.isfinite(qpos).all() and np.abs(qpos).max() < 1e6 and np.abs(qvel).max() < 1e6):
            return self._measure(), float("nan"), False
        data, model = self._data, self.model
        data.qpos[:], data.qvel[:] = qpos, qvel
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_sensorPos(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_sensorVel(model, data)
        # Contacts are the engine's own.
        touching = engine.touching()
        for body, sensor in self._contacts.items():
            data.sensordata[sensor] = float(body in touching)
        return self._measure(), lowest_point(model, data, self._geoms), True

    def _measure(self) -> Measurement:
        data = self._data
        return self.task.measure(data.qpos.copy(), data.qvel.copy(), data.sensordata.copy())


def walk(task: SimulatedTask, policy: Policy, engine: Engine, start: tuple[np.ndarray, np.ndarray], seed: int) -> Walk:
    """Run one episode of a policy in an engine, until the task ends it.

    Args:
        task: The task, which measures and ends episodes.
        policy: The exported policy.
        engine: The engine, with the task's robot.
        start: Initial ``qpos`` and ``qvel``.
        seed: Seed of the task's commands.
    """
    sensing, rng = Sensing(task), np.random.default_rng(seed)
    engine.reset(*start)
    policy.reset(at_home=True)
    now, _, _ = sensing(engine)
    memory = task.begin(now, rng)
    centre, scale = task.robot.action_map
    rows: list[tuple[np.ndarray | float, ...]] = []
    refused: list[str] = []
    outcome = None
    for step in range(task.time_limit):
        readings, command = given(task, policy, now, memory)
        try:
            asked = policy.step(readings, step * task.control_dt, command=command)
        except ReadingError as error:
            refused.append(str(error))
            asked = error.command
        desired = np.array([asked[servo.actuator] for servo in policy.contract.servos])
        engine.advance(desired)
        now, lowest, finite = sensing(engine)
        memory, outcome = task.advance(memory, now, (desired - centre) / scale, np.array(not finite), rng)
        torque = engine.torque
        rows.append(
            (
                *(now.position, now.height, now.angles, now.velocities, now.feet_down, lowest),
                *(np.sqrt(np.mean(np.square(torque), axis=0)), np.abs(torque).max(axis=0), desired),
            )
        )
        if outcome.terminated or outcome.truncated:
            break
    recorded = ("position", "height", "angles", "rates", "feet_down", "lowest", "torque", "peak", "desired")
    columns = {name: np.array(column) for name, column in zip(recorded, zip(*rows, strict=True), strict=True)}
    finished, fell = (False, False) if outcome is None else (bool(outcome.success), bool(outcome.terminated))
    return Walk(**columns, finished=finished, fell=fell, refused=tuple(refused))


def given(
    task: SimulatedTask, policy: Policy, now: Measurement, memory: Memory
) -> tuple[dict[str, float], dict[str, float] | None]:
    """Return the readings and the commands that a policy's contract asks for."""
    numbers = task.table(Sensed(now, memory, task.facts))
    values = {
        reading.name: number + reading.zero
        for row, of_node in zip(numbers, task.table.readings, strict=True)
        for number, reading in zip(row.tolist(), of_node, strict=True)
        if reading is not None
    }
    commands = {name: values[name] for name in policy.contract.commands}
    return {name: values[name] for name in policy.contract.readings}, commands or None
