"""The walking task for dm_control: a Physics, a Task, and the TorchRL environment around them."""

from __future__ import annotations

import collections
import warnings
from typing import Any

import dm_env
import mujoco as mujoco_api
import numpy as np
from dm_env import specs
from torchrl.envs import DMControlWrapper

from gctd3.envs.mujoco_state import integration_state, load_integration_state
from gctd3.envs.settings import Start
from gctd3.envs.simulation import substeps_of
from gctd3.tasks.step_records import Measurement, Outcome, Progress, from_dict, to_dict
from gctd3.tasks.walk import FEATURES, WalkingTask

with warnings.catch_warnings():
    # Without a display GLFW only warns, and dm_control settles on it; an error sends it on to EGL, then OSMesa.
    warnings.filterwarnings("error", module="glfw")
    from dm_control import mujoco
    from dm_control.rl import control
    from dm_control.suite import base


class Physics(mujoco.Physics):
    """A robot with its sensors in the task's terms."""

    def measure(self, task: WalkingTask) -> Measurement:
        """What the robot senses now."""
        data = self.data
        return task.measure(np.array(data.qpos), np.array(data.qvel), np.array(data.sensordata))


class Walk(base.Task):
    """Walk forward as far as the finish.

    Args:
        task: The task's arithmetic.
        start: Where episodes start.
        random: Seed or state of the starts.
    """

    def __init__(
        self, task: WalkingTask, start: Start | None = None, random: int | np.random.RandomState | None = None
    ) -> None:
        super().__init__(random=random)
        self.task = task
        self.start = start if start is not None else Start()
        self._now: Measurement
        self._progress: Progress
        self._outcome: Outcome | None = None
        low, high = task.robot.action_range.T
        self._middle, self._half = (high + low) / 2, (high - low) / 2

    def initialize_episode(self, physics: Physics) -> None:
        """Put the robot into the pose in which it starts, every joint off by a little."""
        joints = self.task.robot.joints
        physics.data.qpos[:] = self.task.robot.start_qpos
        noise = self.start.angle_noise, self.start.velocity_noise
        physics.data.qpos[[j.qpos for j in joints]] += self.random.uniform(-noise[0], noise[0], len(joints))
        physics.data.qvel[[j.qvel for j in joints]] += self.random.uniform(-noise[1], noise[1], len(joints))
        self.restart(physics)

    def restart(self, physics: Physics) -> None:
        """Begin an episode in the state that the physics has now."""
        physics.forward()
        self._now = physics.measure(self.task)
        self._progress = self.task.begin(self._now)
        self._outcome = None

    def action_spec(self, physics: Physics) -> specs.BoundedArray:
        """One desired joint angle per actuator, in [-1, 1] of its range."""
        names = "\t".join(self.task.robot.action_names)
        return specs.BoundedArray((len(self._half),), np.float64, -1.0, 1.0, name=names)

    def before_step(self, action: np.ndarray, physics: Physics) -> None:
        """Map the action onto the servos' ranges."""
        physics.set_control(self._middle + self._half * np.clip(action, -1.0, 1.0))

    def after_step(self, physics: Physics) -> None:
        """Judge the step."""
        self._now = physics.measure(self.task)
        self._progress, self._outcome = self.task.advance(self._progress, self._now)

    def diverge(self) -> None:
        """Judge a step whose simulation failed: the robot stays where it was, and the episode ends as by a fall."""
        self._progress, self._outcome = self.task.advance(self._progress, self._now, np.array(True))

    def get_observation(self, physics: Physics) -> collections.OrderedDict[str, np.ndarray]:
        """The nodes' features, the endings' counters, the distance walked (m) and whether it was won."""
        won = self._outcome is not None and bool(self._outcome.success)
        return collections.OrderedDict(
            nodes=self.task.node_features(self._now),
            counters=self.task.counters(self._progress),
            position=np.array([self._now.position], dtype=np.float32),
            success=np.array([won]),
            diverged=np.array([self._outcome is not None and bool(self._outcome.diverged)]),
        )

    def get_reward(self, physics: Physics) -> float:
        """The sum of the reward's terms."""
        return float(self.outcome.reward)

    def get_termination(self, physics: Physics) -> float | None:
        """0 if the episode terminated, 1 if it was truncated, ``None`` if it goes on."""
        if self.outcome.terminated:
            return 0.0
        return 1.0 if self.outcome.truncated else None

    def state_dict(self) -> dict[str, Any]:
        """What the task remembers of the episode."""
        return {"now": to_dict(self._now), "progress": to_dict(self._progress)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore :meth:`state_dict`."""
        self._now = from_dict(Measurement, state["now"])
        self._progress = from_dict(Progress, state["progress"])

    @property
    def outcome(self) -> Outcome:
        """Of the last step.

        Raises:
            RuntimeError: If no step was taken since the reset.
        """
        if self._outcome is None:
            raise RuntimeError("The episode has not been stepped yet.")
        return self._outcome


class WalkEnvironment(control.Environment):
    """A :class:`dm_control.rl.control.Environment` whose specs do not need a reset."""

    def observation_spec(self) -> collections.OrderedDict[str, specs.Array]:
        """Shapes and types of the observation."""
        task: WalkingTask = self.task.task
        return collections.OrderedDict(
            nodes=specs.Array((len(task.nodes), FEATURES), np.float32, "nodes"),
            counters=specs.Array((task.num_counters,), np.float32, "counters"),
            position=specs.Array((1,), np.float32, "position"),
            success=specs.Array((1,), bool, "success"),
            diverged=specs.Array((1,), bool, "diverged"),
        )

    def step(self, action: np.ndarray) -> dm_env.TimeStep:
        """One control step.

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
            walk: Walk = self.task
            walk.diverge()
            self._reset_next_step = True
            observation = walk.get_observation(self.physics)
            return dm_env.TimeStep(dm_env.StepType.LAST, walk.get_reward(self.physics), 0.0, observation)

    def state_dict(self) -> dict[str, Any]:
        """Everything that the next steps depend on, but the actions."""
        walk: Walk = self.task
        name, keys, position, has_gauss, cached = walk.random.get_state()
        return {
            "physics": integration_state(self.physics.model.ptr, self.physics.data.ptr),
            "reset_next_step": self._reset_next_step,
            "steps": self._step_count,
            "random": [name, keys.tolist(), position, has_gauss, cached],
            **walk.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore :meth:`state_dict`."""
        model, data = self.physics.model.ptr, self.physics.data.ptr
        load_integration_state(model, data, state["physics"])
        mujoco_api.mj_forward(model, data)
        self._reset_next_step, self._step_count = state["reset_next_step"], state["steps"]
        name, keys, position, has_gauss, cached = state["random"]
        self.task.random.set_state((name, np.array(keys, dtype=np.uint32), position, has_gauss, cached))
        self.task.load_state_dict(state)


def load(
    task: WalkingTask,
    start: Start | None = None,
    random: int | np.random.RandomState | None = None,
) -> WalkEnvironment:
    """The walking task as a dm_control environment.

    Args:
        task: The task's arithmetic; it holds the robot and the control period.
        start: Where episodes start.
        random: Seed or state of the starts.
    """
    physics = Physics.from_xml_path(str(task.robot.path))
    return WalkEnvironment(
        physics,
        Walk(task, start, random),
        n_sub_steps=substeps_of(task.control_dt, task.robot),
        # mj_step throughout, as in the batched simulation: sensors are read where the last physics step began.
        legacy_step=False,
    )


def torchrl_env(task: WalkingTask, start: Start | None = None, seed: int = 0) -> DMControlWrapper:
    """The walking task as a TorchRL environment of batch size ``[]``; same keys as the batched one."""
    return DMControlWrapper(load(task, start, seed))
