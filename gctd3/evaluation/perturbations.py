"""Perturbations of a walking robot: pushes, loads, other ground, delayed actions, sensor noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from tensordict import TensorDictBase

from gctd3.envs.simulation import Simulation
from gctd3.robots.altered import altered as altered
from gctd3.robots.altered import resting_action as at_rest
from gctd3.robots.altered import velocity_change as velocity_change
from gctd3.robots.robot import Robot
from gctd3.tasks.simulated_task import SimulatedTask

PolicyFunction = Callable[[TensorDictBase], TensorDictBase]


def resting_action(robot: Robot) -> torch.Tensor:
    """Return the action that commands the servos to the pose in which episodes begin, shape ``[A]``, in [-1, 1]."""
    return torch.from_numpy(at_rest(robot).astype(np.float32))


class Delayed:
    """Delay a policy's actions by some control steps; until the first one arrives, the servos hold the start pose.

    Args:
        policy: The policy; the wrapper serves a single episode of every robot.
        steps: Delay (control steps).
        rest: Action for the start pose, see :func:`resting_action`.
    """

    def __init__(self, policy: PolicyFunction, steps: int, rest: torch.Tensor) -> None:
        self.policy, self.steps, self.rest = policy, steps, rest
        self._waiting: list[torch.Tensor] = []

    def __call__(self, state: TensorDictBase) -> TensorDictBase:
        """Act on ``state``."""
        acting = self.policy(state)
        action = acting["action"]
        if not self._waiting:
            self._waiting = [self.rest.expand_as(action)] * self.steps
        self._waiting.append(action)
        return acting.set("action", self._waiting.pop(0).clone())


class Noisy:
    """Add Gaussian noise to a policy's sensors, drawn once for every frame and kept with it in the frame stack.

    Args:
        policy: The policy; the wrapper serves a single episode of every robot.
        deviation: Standard deviation of every feature of a frame, shape ``[N, F]``; see :func:`sensor_deviation`.
        seed: Seed of the noise.
    """

    def __init__(self, policy: PolicyFunction, deviation: torch.Tensor, seed: int) -> None:
        self.policy, self.deviation = policy, deviation
        self._generator = torch.Generator().manual_seed(seed)
        self._noise: torch.Tensor | None = None

    def __call__(self, state: TensorDictBase) -> TensorDictBase:
        """Act on ``state``, whose ``nodes`` stay as they are."""
        nodes = state["nodes"]
        fresh = self.deviation * torch.randn((*nodes.shape[:-1], self.deviation.shape[-1]), generator=self._generator)
        if self._noise is None:
            # The frame of the reset fills the whole stack, and so does its error.
            self._noise = torch.cat([fresh] * (nodes.shape[-1] // fresh.shape[-1]), dim=-1)
        else:
            self._noise = torch.cat([self._noise[..., fresh.shape[-1] :], fresh], dim=-1)
        seen = state.clone(recurse=False).set("nodes", nodes + self._noise)
        return state.set("action", self.policy(seen)["action"])


def sensor_deviation(task: SimulatedTask, angle: float, velocity: float, length: float, speed: float) -> torch.Tensor:
    """Return the standard deviations of every node feature's error in a frame, ``[N, F]``; contacts have no error.

    Args:
        task: The task, whose nodes observe features.
        angle: Standard deviation for angles, and for the direction of gravity (rad).
        velocity: Standard deviation for angular velocities (rad/s).
        length: Standard deviation for the body's height and its lateral position (m).
        speed: Standard deviation for the body's velocities (m/s).
    """
    errors = {"angle": angle, "direction": angle, "angular velocity": velocity, "length": length, "velocity": speed}
    return torch.from_numpy(task.table.deviations(errors).astype(np.float32))


class Shoved:
    """Push each robot of a policy again and again, in random horizontal directions, each at its own times.

    Args:
        policy: The policy; the wrapper serves a single episode of every robot.
        simulation: The simulation in which the robots walk.
        change: Change of the whole robot's velocity by a push (m/s): its impulse on the root body is ``change`` times
            the robot's mass.
        every: Control steps from one push of a robot to its next; the first one comes after as many at most.
        seed: Seed of the directions and of the first times.
    """

    def __init__(self, policy: PolicyFunction, simulation: Simulation, change: float, every: int, seed: int) -> None:
        self.policy, self.simulation, self.change, self.every = policy, simulation, change, every
        self._rng = np.random.default_rng(seed)
        self._left = self._rng.integers(1, every + 1, simulation.num_robots)

    def __call__(self, state: TensorDictBase) -> TensorDictBase:
        """Push the robots whose time has come, then act on ``state``, which was observed before the push."""
        simulation, robot = self.simulation, self.simulation.task.robot
        ways = self._rng.uniform(0.0, 2.0 * np.pi, simulation.num_robots)
        self._left -= 1
        for i in np.flatnonzero(self._left == 0):
            way = np.array([np.cos(ways[i]), np.sin(ways[i])]) @ robot.base.frame[:2]
            impulse = self.change * robot.model.body_subtreemass[robot.base.root] * way
            simulation.qvel[i] += velocity_change(robot, simulation.qpos[i], impulse)
        self._left = np.where(self._left == 0, self.every, self._left)
        return self.policy(state)


class Pushed:
    """Push each robot of a policy once, some time after a touchdown of its first foot.

    A push changes the velocities from one control step to the next, as an impact does.

    Args:
        policy: The policy; the wrapper serves a single episode of every robot.
        simulation: The simulation in which the robots walk.
        impulses: Impulse on each robot along its forward axis, shape ``[robots]`` (N s); negative against it.
        waits: Control steps from the touchdown to each push, shape ``[robots]``.
        settle: Distance past which a touchdown counts (m).
        swing: Control steps that the foot has to have been in the air before.

    Attributes:
        pushed_at: Control step before which each robot was pushed, -1 if it was not, shape ``[robots]``.
    """

    def __init__(
        self,
        policy: PolicyFunction,
        simulation: Simulation,
        impulses: Sequence[float] | np.ndarray,
        waits: Sequence[int] | np.ndarray,
        settle: float,
        swing: int,
    ) -> None:
        self.policy, self.simulation = policy, simulation
        self.impulses, self.settle, self.swing = np.asarray(impulses), settle, swing
        self.pushed_at = np.full(simulation.num_robots, -1)
        self._left = np.asarray(waits).copy()
        self._armed = np.zeros(simulation.num_robots, dtype=bool)
        self._air = np.zeros(simulation.num_robots, dtype=np.int64)
        self._step = 0

    def __call__(self, state: TensorDictBase) -> TensorDictBase:
        """Push the robots whose wait is over, then act on ``state``, which was observed before the push."""
        now = self.simulation.now
        down = now.feet_down[:, 0]
        self._armed |= down & (self._air >= self.swing) & (now.position >= self.settle)
        self._air = np.where(down, 0, self._air + 1)
        for robot in np.flatnonzero(self._armed & (self._left == 0) & (self.pushed_at < 0)):
            self._push(int(robot))
        self._left[self._armed] -= 1
        self._step += 1
        return self.policy(state)

    def _push(self, index: int) -> None:
        simulation, robot = self.simulation, self.simulation.task.robot
        impulse = self.impulses[index] * robot.base.frame[0]
        simulation.qvel[index] += velocity_change(robot, simulation.qpos[index], impulse)
        self.pushed_at[index] = self._step
