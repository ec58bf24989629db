"""Simulated tasks for dm_control: a Physics, a Task, and the TorchRL environment around them."""

from __future__ import annotations

import collections
import copy
from collections.abc import Mapping
from typing import Any

import mujoco as mujoco_api
import numpy as np
from torchrl.envs import DMControlWrapper

from gctd3.config.requirements import check_dm_control
from gctd3.envs.asked import AnyRobot, ask_simulated
from gctd3.envs.mujoco_state import integration_state, load_integration_state
from gctd3.envs.simulation import substeps_of
from gctd3.robots.actuators import rest_servos
from gctd3.tasks.measurement import Measurement
from gctd3.tasks.memory import Memory
from gctd3.tasks.outcome import Outcome
from gctd3.tasks.simulated_task import SimulatedTask

check_dm_control("gctd3.envs.dmc")

import dm_env  # noqa: E402 - after the check
from dm_control import mujoco  # noqa: E402
from dm_control.mujoco import wrapper  # noqa: E402
from dm_control.rl import control  # noqa: E402
from dm_control.suite import base  # noqa: E402
from dm_env import specs  # noqa: E402


class Physics(mujoco.Physics):
    """Simulate a robot and measure it in the task's terms."""

    def measure(self, task: SimulatedTask, spot: Mapping[str, np.ndarray] | None = None) -> Measurement:
        """Return the present measurement of the robot; ``spot`` is as for :meth:`.SimulatedTask.measure`."""
        data = self.data
        return task.measure(np.array(data.qpos), np.array(data.qvel), np.array(data.sensordata), spot)


class DMTask(base.Task):
    """Wrap a simulated task as a task of dm_control.

    Args:
        task: The simulated task.
        random: Seed or state of the starts and commands.
    """

    def __init__(self, task: SimulatedTask, random: int | np.random.RandomState | None = None) -> None:
        super().__init__(random=random)
        self.task = task
        self._now: Measurement
        self._memory: Memory = {}
        self._spot: Memory | None = None
        self._outcome: Outcome | None = None

    def initialize_episode(self, physics: Physics) -> None:
        """Put the robot into the start pose and velocities of an episode."""
        spot = self.task.place(self.random, (), self._memory or None)
        qpos, physics.data.qvel[:] = self.task.start(self.random)
        physics.data.qpos[:] = self.task.put(qpos, spot)
        self._spot = spot
        rest_servos(physics.model.ptr, physics.data.ptr)
        self.restart(physics)

    def restart(self, physics: Physics) -> None:
        """Begin an episode in the state that the physics has now."""
        physics.forward()
        self._now = physics.measure(self.task, self._spot)
        self._memory = self.task.begin(self._now, self.random, self._memory or None, self._spot)
        self._outcome = None

    def action_spec(self, physics: Physics) -> specs.BoundedArray:
        """Return the spec of the actions: one desired joint angle per actuator, in [-1, 1]."""
        names = "\t".join(self.task.robot.action_names)
        return specs.BoundedArray((len(self.task.robot.actuated),), np.float64, -1.0, 1.0, name=names)

    def before_step(self, action: np.ndarray, physics: Physics) -> None:
        """Send the desired angles of the action to the servos."""
        self._action = action
        physics.set_control(self.task.robot.desired_angles(action))

    def after_step(self, physics: Physics) -> None:
        """Measure the robot and evaluate the step."""
        self._now = physics.measure(self.task, self._memory)
        self._memory, self._outcome = self.task.advance(self._memory, self._now, self._action, rng=self.random)

    def diverge(self) -> None:
        """Evaluate a step whose simulation failed: the robot stays where it was, and the episode ends as by a fall."""
        failed = np.array(True)
        self._memory, self._outcome = self.task.advance(self._memory, self._now, self._action, failed, self.random)

    def get_observation(self, physics: Physics) -> collections.OrderedDict[str, np.ndarray]:
        """Return the nodes' features, the terminations' clocks, the distance walked (m), success and divergence."""
        won = self._outcome is not None and bool(self._outcome.success)
        return collections.OrderedDict(
            nodes=self.task.node_features(self._now, self._memory),
            counters=self.task.counters(self._memory, self._now),
            position=np.array([self._now.position], dtype=np.float32),
            success=np.array([won]),
            diverged=np.array([self._outcome is not None and bool(self._outcome.diverged)]),
        )

    def get_reward(self, physics: Physics) -> float:
        """Return the sum of the reward's terms."""
        return float(self.outcome.reward)

    def get_termination(self, physics: Physics) -> float | None:
        """Return the last discount: 0 if the episode terminated, 1 if it was truncated, ``None`` if it goes on."""
        if self.outcome.terminated:
            return 0.0
        return 1.0 if self.outcome.truncated else None

    def state_dict(self) -> dict[str, Any]:
        """Return the task's memory of the episode."""
        return {"now": self._now.to_dict(), "memory": {name: np.array(v) for name, v in self._memory.items()}}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state returned by :meth:`state_dict`."""
        self._now = Measurement.from_dict(state["now"])
        self._memory = {name: np.array(values) for name, values in state["memory"].items()}

    @property
    def outcome(self) -> Outcome:
        """Return the outcome of the last step.

        Raises:
            RuntimeError: If no step was taken since the reset.
        """
        if self._outcome is None:
            raise RuntimeError("The episode has not been stepped yet.")
        return self._outcome


class DMEnvironment(control.Environment):
    """Provide a :class:`dm_control.rl.control.Environment` whose specs do not need a reset."""

    def observation_spec(self) -> collections.OrderedDict[str, specs.Array]:
        """Return the shapes and types of the observation."""
        task: SimulatedTask = self.task.task
        return collections.OrderedDict(
            nodes=specs.Array((task.graph.num_nodes, task.features), np.float32, "nodes"),
            counters=specs.Array((task.num_counters,), np.float32, "counters"),
            position=specs.Array((1,), np.float32, "position"),
            success=specs.Array((1,), bool, "success"),
            diverged=specs.Array((1,), bool, "diverged"),
        )

    def step(self, action: np.ndarray) -> dm_env.TimeStep:
        """Take one control step.

        Raises:
            ValueError: If the action has the wrong shape or is not finite.
        """
        expected = self.action_spec().shape
        values = np.asarray(action, dtype=np.float64)
        if values.shape != expected or not np.isfinite(values).all():
            raise ValueError(f"An action must be finite and of shape {expected}, got {action}.")
        try:
            return super().step(values)
        except control.PhysicsError:
            walk: DMTask = self.task
            walk.diverge()
            self._reset_next_step = True
            observation = walk.get_observation(self.physics)
            return dm_env.TimeStep(dm_env.StepType.LAST, walk.get_reward(self.physics), 0.0, observation)

    def state_dict(self) -> dict[str, Any]:
        """Return everything that the next steps depend on, except the actions."""
        walk: DMTask = self.task
        name, keys, position, has_gauss, cached = walk.random.get_state()
        return {
            "physics": integration_state(self.physics.model.ptr, self.physics.data.ptr),
            "reset_next_step": self._reset_next_step,
            "steps": self._step_count,
            "random": [name, keys.tolist(), position, has_gauss, cached],
            **walk.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state returned by :meth:`state_dict`."""
        model, data = self.physics.model.ptr, self.physics.data.ptr
        load_integration_state(model, data, state["physics"])
        mujoco_api.mj_forward(model, data)
        self._reset_next_step, self._step_count = state["reset_next_step"], state["steps"]
        name, keys, position, has_gauss, cached = state["random"]
        self.task.random.set_state((name, np.array(keys, dtype=np.uint32), position, has_gauss, cached))
        self.task.load_state_dict(state)


def load(
    task: SimulatedTask | AnyRobot = "biped",
    random: int | np.random.RandomState | None = None,
    **asked: Any,  # noqa: ANN401 - of `ask`
) -> DMEnvironment:
    """Load a simulated task as a dm_control environment.

    Args:
        task: The simulated task; or its robot, as ``robot=`` of the command line takes it, see :func:`.ask`.
        random: Seed or state of the starts and commands.
        asked: Other arguments of :func:`.ask`, if ``task`` is a robot: ``reward``, ``control_dt``, ``feet``,
            ``forward``, ``terminations``, ``overrides``, and ``settings``, those of the task.

    Raises:
        ConfigError: If an argument is not what is expected, or does not fit the robot.
        RobotError: If the robot cannot be used.
    """
    if "settings" in asked:
        asked["task"] = asked.pop("settings")
    built = ask_simulated(task, **asked)
    # A copy of the model, so that changing it (a payload) does not affect other environments.
    physics = Physics.from_model(wrapper.MjModel(copy.deepcopy(built.stage.model)))
    return DMEnvironment(
        physics,
        DMTask(built, random),
        n_sub_steps=substeps_of(built.control_dt, built.robot),
        # mj_step throughout, as in the batched simulation: sensors are read where the last physics step began.
        legacy_step=False,
    )


def torchrl_env(task: SimulatedTask, seed: int = 0) -> DMControlWrapper:
    """Wrap a task as a TorchRL environment of batch size ``[]``; the batched one adds ``is_init``, ``step_count``."""
    return DMControlWrapper(load(task, seed))
