"""The robot of a contract in MuJoCo, driven by desired joint angles and read by the contract's names."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from gctd3.bridge.inertial import orientation_of
from gctd3.bridge.messages import ImuSample
from gctd3.bridge.names import DISTANCE
from gctd3.deploy.contract import Contract
from gctd3.envs.simulation import substeps_of
from gctd3.errors import ContractError
from gctd3.robots.actuators import rest_servos
from gctd3.robots.physics import physics_hash
from gctd3.tasks.features import Sensed
from gctd3.tasks.heading import coordinate
from gctd3.tasks.outcome import Outcome
from gctd3.tasks.simulated_task import SimulatedTask
from gctd3.training.saved_configuration import find_run, load_settings
from gctd3.training.saved_robot import setup_of

BODY = "base_link"  # REP 105's name for the axes of the body


class Plant:
    """Simulate one robot of a run.

    Args:
        task: Task of the run, with its robot.
        contract: Contract of the policy that drives it.
        seed: Seed of the starts; ``None`` for the start pose itself.
        seconds: Simulated time after which an episode ends (s); ``None`` for the task's time limit.

    Attributes:
        steps: Control steps since the start of the episode.
        ended: How the episode ended, ``None`` if it has not: ``finish``, ``fall`` or ``time``.

    Raises:
        ContractError: If the policy is for another robot, or reads what the task does not measure.
    """

    def __init__(
        self, task: SimulatedTask, contract: Contract, seed: int | None = None, seconds: float | None = None
    ) -> None:
        self.task, self.contract, self.model = task, contract, task.robot.model
        if physics_hash(self.model) != contract.robot.sha256:
            raise ContractError(
                f"The policy is for the robot {contract.robot.name!r}, and run= is of {task.robot.path.stem!r}, "
                "which is another one: give the run from which it was exported."
            )
        known = {one.name for row in task.table.readings for one in row if one is not None}
        if missing := [name for name in contract.readings if name not in known]:
            raise ContractError(f"The run's task does not measure {', '.join(missing)}, which the policy reads.")
        self.substeps = substeps_of(task.control_dt, task.robot)
        self._most = None if seconds is None else max(round(seconds / task.control_dt), 1)
        self._rng = np.random.default_rng(seed)
        self._random = seed is not None
        self._data = mujoco.MjData(self.model)
        index = {task.robot.action_names[i]: i for i in range(self.model.nu)}
        self._actuators = [index[servo.actuator] for servo in contract.servos]
        self._centre, self._scale = np.array([[s.centre_rad, s.scale_rad] for s in contract.servos]).T
        self.reset()

    @property
    def qpos(self) -> np.ndarray:
        """Return the generalised positions, shape ``[nq]``."""
        return np.array(self._data.qpos)

    @property
    def distance(self) -> float:
        """Return the distance walked since the start of the episode (m)."""
        return float(self._now.position[0])

    def reset(self) -> None:
        """Start an episode."""
        model, data, task = self.model, self._data, self.task
        mujoco.mj_resetData(model, data)
        if self._random:
            data.qpos[:], data.qvel[:] = task.start(self._rng)
        else:
            data.qpos[:], data.qvel[:] = task.robot.start_qpos, 0.0
        rest_servos(model, data)
        mujoco.mj_forward(model, data)
        self._now = task.measure(data.qpos[None].copy(), data.qvel[None].copy(), data.sensordata[None].copy())
        self._memory = task.begin(self._now, self._rng)
        self.steps = 0
        self.ended: str | None = None

    def readings(self) -> dict[str, float]:
        """Return the value of each reading of the contract by name, and ``distance_m``."""
        values = self.task.table.named(Sensed(self._now, self._memory, self.task.facts))
        return {**{name: float(values[name][0]) for name in self.contract.readings}, DISTANCE: self.distance}

    def imu(self, stamp: int) -> ImuSample:
        """Return what an inertial unit at the root body's origin measures, in the axes of :mod:`.inertial`.

        Orientation and angular velocity are from the measurement from which :meth:`readings` are, the acceleration is
        that of the last step of the physics.

        Args:
            stamp: Time of the readings (ns).
        """
        task, turns = self.task, ("roll", "pitch", "yaw")
        angles, rates = (
            [float(coordinate(self._now, task.facts, name, rate)[0]) for name in turns] for rate in (False, True)
        )
        orientation = orientation_of(*angles)
        mujoco.mj_rnePostConstraint(self.model, self._data)
        motion, turn = np.zeros(6), np.zeros(9)
        mujoco.mj_objectAcceleration(self.model, self._data, mujoco.mjtObj.mjOBJ_XBODY, task.robot.base.root, motion, 0)
        mujoco.mju_quat2Mat(turn, np.roll(orientation, 1))
        # MuJoCo counts gravity as an acceleration upwards, as an accelerometer does.
        x, y, z = (turn.reshape(3, 3).T @ (task.robot.base.frame @ motion[3:])).tolist()
        return ImuSample(stamp, BODY, orientation, (rates[0], rates[1], rates[2]), (x, y, z))

    def command(self, angles: Mapping[str, float]) -> None:
        """Set the desired angles by the name of the actuator (rad), which hold until the next call."""
        self._data.ctrl[self._actuators] = [angles[servo.actuator] for servo in self.contract.servos]

    def substep(self) -> None:
        """Take one step of the physics."""
        mujoco.mj_step(self.model, self._data)

    def finish_step(self) -> None:
        """Measure after the last step of the physics in a control step, and tell whether the episode has ended."""
        data = self._data
        measured = data.qpos[None].copy(), data.qvel[None].copy(), data.sensordata[None].copy()
        diverged = np.array([not all(np.isfinite(values).all() for values in measured)])
        if not diverged[0]:
            self._now = self.task.measure(*measured)
        # The terms of the task count actions; of the angles in force.
        action = np.clip((data.ctrl[self._actuators] - self._centre) / self._scale, -1.0, 1.0)
        self._memory, outcome = self.task.advance(self._memory, self._now, action[None], diverged, self._rng)
        self.steps += 1
        self.ended = self._end(outcome)

    def step(self, angles: Mapping[str, float]) -> None:
        """Take a control step with desired angles by the name of the actuator (rad)."""
        self.command(angles)
        for _ in range(self.substeps):
            self.substep()
        self.finish_step()

    def _end(self, outcome: Outcome) -> str | None:
        if outcome.terminated[0]:
            return "fall"
        if outcome.success[0]:
            return "finish"
        over = outcome.truncated[0] if self._most is None else self.steps >= self._most
        return "time" if over else None


def plant_of(run: str | None, contract: Contract, seed: int | None, seconds: float | None) -> Plant:
    """Build the robot of a run, without PyTorch.

    Args:
        run: Directory of the run; ``None`` for the biped that ships with gctd3.
        contract: Contract of the policy.
        seed: Seed of the starts; ``None`` for the start pose itself.
        seconds: Simulated time after which an episode ends (s); ``None`` for the task's time limit.

    Raises:
        RunError: If it is no run of a simulated task.
        ContractError: If the policy is for another robot.
    """
    from gctd3.tasks.task import check_able

    directory = find_run(run)
    settings = load_settings(directory)
    task = setup_of(directory, settings).task
    check_able(task, "export", directory)
    assert isinstance(task, SimulatedTask)
    # Its robot is the one of the contract, on the plane of its file.
    return Plant(task.evaluated(settings.evaluation.reward).on_plane(), contract, seed, seconds)
