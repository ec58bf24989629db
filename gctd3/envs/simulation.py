"""N robots of one kind stepped together by MuJoCo's rollout pool, with a task on top. NumPy in and out."""

from __future__ import annotations

import os
from typing import Any

import mujoco
import numpy as np

from gctd3.errors import ConfigError, NumericalError, RobotError
from gctd3.robots.actuators import rest_servos
from gctd3.robots.altered import velocity_change
from gctd3.robots.robot import Robot
from gctd3.tasks.domain_randomisation import MODEL, build_models
from gctd3.tasks.measurement import Measurement, put_rows
from gctd3.tasks.memory import Memory
from gctd3.tasks.outcome import Outcome
from gctd3.tasks.simulated_task import SimulatedTask

MOST_SUBSTEPS = 1000
# Start of the simulator's clock (s). Not 0: MuJoCo sets it to 0 when it resets a diverged robot, which reveals that.
BEGINNING = 1.0


class Simulation:
    """Simulate a batch of robots: physics, sensing, reward and terminations; the caller resets them.

    Args:
        task: The task; it holds the robot.
        num_robots: Number of robots stepped together.
        seed: Seed of the starts and commands.
        threads: Threads of the pool; all cores if ``None``. Results do not depend on it.

    Raises:
        ConfigError: If a count is below 1, or the task's control period is not a multiple of the MJCF's timestep.
    """

    def __init__(
        self,
        task: SimulatedTask,
        num_robots: int,
        seed: int = 0,
        threads: int | None = None,
    ) -> None:
        if num_robots < 1:
            raise ConfigError(f"num_envs must be at least 1, got {num_robots}.")
        self.threads = threads if threads is not None else os.cpu_count() or 1
        if self.threads < 1:
            raise ConfigError(f"threads must be at least 1, got {threads}.")
        self.task = task
        self.model = task.stage.model
        self.num_robots = num_robots
        self.substeps = substeps_of(task.control_dt, task.robot)
        self.rng = np.random.default_rng(seed)
        nq, nv = self.model.nq, self.model.nv
        spec = mujoco.mjtState.mjSTATE_FULLPHYSICS
        self.state = np.zeros((num_robots, mujoco.mj_stateSize(self.model, spec.value)))
        self._qpos, self._qvel = slice(1, 1 + nq), slice(1 + nq, 1 + nq + nv)
        self._states = np.empty((num_robots, self.substeps, self.state.shape[1]))
        self._sensors = np.empty((num_robots, self.substeps, self.model.nsensordata))
        self._before = self.state
        self._variants = [self.model]
        if task.domain is not None:
            # Drawn by a separate generator, so that starts and commands are the same ones without it.
            self._alter(task.domain.settings.draw_models(np.random.default_rng([seed, 1])))
        self._data = [mujoco.MjData(self.model) for _ in range(self.threads)]
        # A pool of one thread only adds a hand-over; without a pool the calling thread steps.
        from mujoco.rollout import Rollout  # late: it runs MuJoCo's code, which settings do without

        self._pool = Rollout(nthread=0 if self.threads == 1 else self.threads)
        self.now: Measurement = task.measure(
            self.state[:, self._qpos], self.state[:, self._qvel], np.zeros((num_robots, self.model.nsensordata))
        )
        # Drawn by a separate generator: this belongs to no episode, and the first episode needs the seed's own draws.
        self.memory: Memory = task.begin(self.now, np.random.default_rng(seed))

    @property
    def qpos(self) -> np.ndarray:
        """Return the generalised positions, shape ``[N, nq]``."""
        return self.state[:, self._qpos]

    @property
    def qvel(self) -> np.ndarray:
        """Return the generalised velocities, shape ``[N, nv]``."""
        return self.state[:, self._qvel]

    def _alter(self, numbers: np.ndarray) -> None:
        self._numbers = numbers
        domain = self.task.domain
        self._variants = build_models(self.task.stage, numbers) if domain and domain.settings.alters else [self.model]

    def reset(self, mask: np.ndarray) -> None:
        """Start a new episode for the robots where ``mask`` (bool ``[N]``) holds."""
        robots = np.flatnonzero(mask)
        if not len(robots):
            return
        task, model = self.task, self.model
        sensors = np.zeros((len(robots), model.nsensordata))
        data = self._data[0]
        last = {name: self.memory[name][robots] for name in task.memory.lasting}
        spot = task.place(self.rng, robots.shape, last)
        for i, robot in enumerate(robots):
            mujoco.mj_resetData(model, data)
            data.time = BEGINNING
            qpos, data.qvel[:] = task.start(self.rng)
            data.qpos[:] = task.put(qpos, {name: values[i] for name, values in spot.items()})
            rest_servos(model, data)
            mujoco.mj_forward(model, data)
            # The full physics state: actuators can have a state of their own.
            mujoco.mj_getState(model, data, self.state[robot], mujoco.mjtState.mjSTATE_FULLPHYSICS.value)
            sensors[i] = data.sensordata
        fresh = task.measure(self.state[robots, self._qpos], self.state[robots, self._qvel], sensors, spot)
        self.now = self.now.put(robots, fresh)
        self.memory = put_rows(self.memory, robots, task.begin(fresh, self.rng, last, spot))

    def step(self, action: np.ndarray) -> Outcome:
        """Take one control step of every robot; ``action [N, A]`` in [-1, 1] asks for :meth:`.Robot.desired_angles`.

        A robot whose simulation fails stays where it was, and its episode ends as by a fall.

        Raises:
            NumericalError: If an action is not finite; MuJoCo would stop that robot without a word.
        """
        if not np.isfinite(action).all():
            robot, index = np.argwhere(~np.isfinite(action))[0]
            raise NumericalError(
                f"Actions must be finite, got {action[robot, index]} for actuator {index} of robot {robot}: "
                "the policy that chose it has diverged"
            )
        models, desired = self._disturb(action)
        control = np.repeat(desired[:, None, :], self.substeps, axis=1)
        before, self.state = self.state, self._states[:, -1]
        self._before = before
        # Shapes and types are right by construction; to check them again takes as long as to step a robot.
        into = {"state": self._states, "sensordata": self._sensors, "nstep": self.substeps, "skip_checks": True}
        self._pool.rollout(models, self._data, before, control, **into)
        # MuJoCo starts a robot anew whose state is not finite, its clock too.
        late = before[:, 0] + self.task.control_dt - self.state[:, 0]
        diverged = ~(np.abs(late) < self.model.opt.timestep / 2) | ~np.isfinite(self.state).all(axis=-1)
        self.state = np.where(diverged[:, None], before, self.state)
        qpos, qvel = self.state[:, self._qpos], self.state[:, self._qvel]
        now = self.task.measure(qpos, qvel, self._sensors[:, -1], self.memory)
        robots = np.flatnonzero(diverged)
        self.now = now.put(robots, self.now.take(robots)) if len(robots) else now
        self.memory, outcome = self.task.advance(self.memory, self.now, action, diverged, self.rng)
        return outcome

    def _disturb(self, action: np.ndarray) -> tuple[list[mujoco.MjModel], np.ndarray]:
        """Push the robots that are due; return each robot's model and the desired angles at its servos ``[N, A]``."""
        domain, memory, robot = self.task.domain, self.memory, self.task.robot
        if domain is None:
            return [self.model] * self.num_robots, self.desired(action)
        models = [self._variants[i] for i in memory[MODEL]]
        for i in domain.pushed(memory):
            model = models[i]
            change = domain.draw_push(self.rng) @ robot.base.frame[:2] * model.body_subtreemass[robot.base.root]
            self.state = self.state.copy()
            self.qvel[i] += velocity_change(robot, self.qpos[i], change, model)
        # A servo that measures an angle too large by a bias holds it too small by as much.
        return models, self.desired(domain.applied(memory, action)) - domain.servo_bias(memory)

    def desired(self, action: np.ndarray) -> np.ndarray:
        """Return the desired joint angles of an action ``[*, A]``, shape ``[*, A]`` (rad)."""
        return self.task.robot.desired_angles(action)

    def trail(self) -> np.ndarray:
        """Return the full physics states through the last control step, its beginning and end included.

        Shape ``[N, substeps + 1, size]``: time (s), ``qpos``, ``qvel`` and the actuators' states.
        """
        return np.concatenate([self._before[:, None], self._states], axis=1)

    def state_dict(self) -> dict[str, Any]:
        """Return everything that the next steps depend on, except the actions."""
        return {
            "state": self.state.copy(),
            "now": self.now.to_dict(),
            "memory": {name: np.array(values) for name, values in self.memory.items()},
            "rng": self.rng.bit_generator.state,
            **({} if self.task.domain is None else {"models": self._numbers.copy()}),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state returned by :meth:`state_dict`."""
        self.state = np.array(state["state"])
        self.now = Measurement.from_dict(state["now"])
        self.memory = {name: np.array(values) for name, values in state["memory"].items()}
        self.rng.bit_generator.state = state["rng"]
        if self.task.domain is not None and not np.array_equal(self._numbers, state["models"]):
            self._alter(np.array(state["models"]))


def substeps_of(control_dt: float, robot: Robot) -> int:
    """Return the number of physics steps in a control step.

    Raises:
        ConfigError: If the period is not a whole multiple, 1 to 1000, of the MJCF's timestep.
        RobotError: If the timestep is not positive.
    """
    timestep = robot.model.opt.timestep
    # MuJoCo takes any number for a timestep.
    if not timestep > 0:
        raise RobotError(f"{robot.path}: the timestep must be above 0 s, got {timestep}.")
    ratio = control_dt / timestep
    if not 0.5 < ratio < MOST_SUBSTEPS + 0.5 or abs(round(ratio) * timestep - control_dt) > 1e-9:
        nearest = timestep * min(max(round(ratio), 1), MOST_SUBSTEPS)
        raise ConfigError(
            f"task.control_dt must be 1 to {MOST_SUBSTEPS:,} times {timestep:g} s, the timestep of {robot.path}, "
            f"got {control_dt:g} s: the nearest that fits is {nearest:g} s."
        )
    return round(ratio)
